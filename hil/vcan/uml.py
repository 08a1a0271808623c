"""Boot a user-mode kernel, run the command in it, hand back its output and status.

``argv`` says what the supervisor must execute: ourselves again, in namespaces of our own, where ``boot`` does the
work. So all that lives, is mounted or lies in a temporary directory goes with those namespaces.
"""

from __future__ import annotations

import atexit
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from hil.errors import HilError
from hil.files import open_regular, read_regular
from hil.vcan import guest
from hil.vcan.kernel import Kernel
from hil.vcan.supervise import RUNNER_FAILED, RunnerError, Wanted, die_with_parent, say, unshare

ROOT: Final = Path(__file__).resolve().parents[2]  # of the package hil
# The inner process: isolated and without site-packages, as it needs neither and shall start at once.
BOOT: Final = "import sys; sys.path.append(sys.argv[1]); from hil.vcan.uml import boot; sys.exit(boot(sys.argv[2]))"
MEMORY: Final = "2048M"  # sparse: costs what is touched
ROOM: Final = "2112M"  # for it and the work directory, which the guest can fill
START_NS: Final = 1_735_689_600_000_000_000  # the guest's wall clock at boot in virtual time: 2025-01-01
MOST_BYTES: Final = 128 << 10  # of one argument of a process in Linux, its end included
COVERED: Final = "/sys"  # the private tmpfs lies here: always there, and the guest has its own anyway


def argv(wanted: Wanted, find: Callable[[Wanted], Kernel]) -> list[str]:
    """Return what to execute so that the command runs in the kernel that `find` gives.

    Raises:
        RunnerError: there is no kernel, or no place for its memory.
    """
    kernel = find(wanted)
    if wanted.verbose:
        say(f"{kernel.describe()}, {'virtual' if wanted.virtual_time else 'real'} time")
    order: dict[str, Any] = {
        "kernel": str(kernel.path),
        "backend": kernel.backend,
        "modules": [str(m) for m in kernel.modules],
        "virtual_time": wanted.virtual_time,
        "readable": readable(wanted.writable, [sys.prefix, sys.base_prefix, str(ROOT), *os.get_exec_path()]),
        "writable": wanted.writable,
        "command": wanted.command,
    }
    _check_order(order)
    try:
        # Not in a user namespace: there setuid programs (mount) would run as the user nobody in the guest, too.
        private = unshare("pid", "mount", allow_user=False)
        order["work"] = order["memory"] = COVERED
    except RunnerError:  # a plain container, or not root: our own exit must clean up
        private = []
        order["work"], order["memory"] = tempfile.mkdtemp(prefix="hil-vcan."), _roomy_directory()
        atexit.register(shutil.rmtree, order["work"], ignore_errors=True)
    return [*private, sys.executable, "-ISc", BOOT, str(ROOT), json.dumps(order)]


def _check_order(order: Mapping[str, Any]) -> None:
    """Refuse what would not come to the guest as it is.

    Raises:
        RunnerError: a directory whose name ends at its comma in a mount's options, or a command that is too long.
    """
    for place in (os.getcwd(), *order["writable"], *order["readable"]):
        if "," in place or "\\" in place:
            raise RunnerError(f"{place!r}: a comma or backslash in a directory's name: it cannot be mounted; rename it")
    length = len(json.dumps(order))
    if length >= MOST_BYTES:
        raise RunnerError(f"command and directories take {length} bytes, {MOST_BYTES} at most; put the command into a script")


def readable(writable: Sequence[str], needed: Sequence[str]) -> list[str]:
    """Return what the guest must see of this machine's /tmp, as its own is empty: a virtual environment may lie there.

    Args:
        writable: directories that it sees anyway.
        needed: directories of the command's programs.

    >>> readable(["/tmp/here"], ["/usr/bin", "/tmp/there/bin", "/tmp/here/.venv", "/tmp/there"])
    ['/tmp/there']
    """
    kept: list[Path] = []
    for place in sorted(map(Path, needed)):  # a directory before what lies in it
        if place.is_relative_to("/tmp") and not any(place.is_relative_to(seen) for seen in (*map(Path, writable), *kept)):
            kept.append(place)
    return [str(place) for place in kept]


def boot(order_text: str) -> int:
    """Boot, wait for the end, return the command's status; the first process of its namespaces runs this."""
    try:
        return _boot(json.loads(order_text))
    except (OSError, subprocess.CalledProcessError) as why:
        say(f"the kernel cannot be started: {why}")
        return RUNNER_FAILED


def _boot(order: Mapping[str, Any]) -> int:
    work = Path(order["work"])
    if order["work"] == COVERED:
        # No other process sees it and it ends with us, however we end; /dev/shm may be small or noexec.
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"exec,size={ROOM}", "hil-vcan", COVERED], check=True)
    stdin = not order["virtual_time"] and _has_stdin()  # when bytes arrive is no part of virtual time
    command = guest.command(order["command"], os.environ, order["backend"], order["virtual_time"])
    (work / "command").write_bytes(os.fsencode(command))  # arguments need not be text
    modules = [Path(m) for m in order["modules"]]
    init = guest.first_process(
        work=work,
        readable=[place for place in order["readable"] if Path(place).is_dir()],
        writable=order["writable"],
        modules=modules,
        python=sys.executable,
        stdin=stdin,
    )
    (work / "init").write_bytes(os.fsencode(init))
    (work / "init").chmod(0o755)
    if not _run_kernel(work, stdin, order):
        return 128 + signal.SIGPIPE
    return _status(work)


def _run_kernel(work: Path, stdin: bool, order: Mapping[str, Any]) -> bool:
    """Boot the kernel on `work` and carry its terminals' bytes until it has powered off; False if our reader left."""
    out_r, out_w = os.pipe()
    err_r, err_w = os.pipe()
    in_r, in_w = os.pipe()
    ask_r, ask_w = os.pipe()
    with (work / "kernel.log").open("wb") as log:
        args = [
            order["kernel"], f"mem={MEMORY}", "rootfstype=hostfs", "rootflags=/", "ro", f"init={work}/init",
            f"uml_dir={work}", "umid=uml", "con=null", "ssl=null", f"con0=null,fd:{log.fileno()}",
            f"con1=null,fd:{out_w}", f"con2=null,fd:{err_w}", "quiet", "loglevel=4", "panic=-1", "noreboot",
        ]  # fmt: skip
        if stdin:
            args.append(f"con3=fd:{in_r},fd:{ask_w}")
        if order["virtual_time"]:
            args += ["time-travel=inf-cpu", f"time-travel-start={START_NS}"]
        child = subprocess.Popen(
            args,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            pass_fds=(log.fileno(), out_w, err_w, in_r, ask_w),
            # SIGTERM on this process ends the whole kernel, SIGKILL only itself.
            preexec_fn=partial(die_with_parent, signal.SIGTERM),  # noqa: PLW1509 (no thread yet)
            env={"PATH": os.environ["PATH"], "TMPDIR": order["memory"]},  # the guest's memory is an unlinked file there
        )
    for fd in (out_w, err_w, in_r, ask_w):
        os.close(fd)
    if stdin:
        threading.Thread(target=_feed, args=(ask_r, in_w), daemon=True).start()
    with ThreadPoolExecutor() as threads:
        pumps = [threads.submit(_pump, *fds, child) for fds in ((out_r, 1), (err_r, 2))]
        child.wait()
    return all(pump.result() for pump in pumps)


def _status(work: Path) -> int:
    """The command's status as the guest left it; else its kernel's last words. The guest can write anything there."""
    try:
        said = read_regular(work / "status", 8, "the status of a command")
    except HilError:
        say("the guest died; its last words:")
        with suppress(HilError, OSError), open_regular(work / "kernel.log", "the log of a kernel", follow=False) as log:
            log.seek(max(log.seek(0, os.SEEK_END) - 4000, 0))
            sys.stderr.write(log.read(4000).decode(errors="replace"))
        return RUNNER_FAILED
    if not re.fullmatch(rb"[0-9]{1,3}\n", said) or int(said) > 255:
        say(f"the guest left {said!r} where the status of its command stands")
        return RUNNER_FAILED
    return int(said)


def _roomy_directory() -> str:
    """A directory that may hold the guest's memory: not noexec, and with a gigabyte free."""
    for directory in ("/dev/shm", tempfile.gettempdir(), "/var/tmp"):
        stat = os.statvfs(directory)
        if not stat.f_flag & os.ST_NOEXEC and stat.f_bavail * stat.f_frsize > 2**30:
            return directory
    raise RunnerError("no directory for the guest's memory: /dev/shm needs 1 GB, not noexec")


def _has_stdin() -> bool:
    """Whether stdin is open and not /dev/null."""
    try:
        return os.fstat(0).st_rdev != os.stat(os.devnull).st_rdev
    except OSError:
        return False


def _pump(source: int, target: int, child: subprocess.Popen[bytes]) -> bool:
    """Carry bytes until the source ends; False, and the guest ends, if they are not wanted any more."""
    try:
        while data := os.read(source, 65536):
            _write(target, data)
    except BrokenPipeError:
        child.terminate()
        return False
    return True


def _feed(ask: int, target: int) -> None:
    """Carry stdin in frames, one for each byte by which the guest asks for it, and an empty one at its end."""
    with suppress(OSError):  # the guest has gone
        while os.read(ask, 1):
            _write(target, guest.frame(os.read(0, guest.CHUNK)))


def _write(fd: int, data: bytes) -> None:
    while data:
        data = data[os.write(fd, data) :]
