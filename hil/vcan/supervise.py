"""Children that never outlive us, however we end.

A child gets PID and mount namespaces of its own where the kernel allows that: with the first process of a
PID namespace all others die, and with a mount namespace its mounts. The kernel kills that first process
when we are gone (``PR_SET_PDEATHSIG``), so that even ``kill -9`` leaves nothing. Where namespaces are
refused, orphans fall to us (``PR_SET_CHILD_SUBREAPER``), and every ordinary end sweeps them up.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hil.errors import HilError

TIMED_OUT: Final = 124
RUNNER_FAILED: Final = 125
PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36


class RunnerError(HilError):
    """The runner, not the command, failed; the message says what is missing."""


def say(message: str) -> None:
    """Write lines of the runner's own, apart from the command's output."""
    sys.stderr.write("".join(f"hil vcan: {line}\n" for line in message.split("\n")))
    sys.stderr.flush()


def unshare(*namespaces: str, allow_user: bool = True) -> list[str]:
    """Prefix that runs a command in new namespaces (``net``, ``pid``, ``mount``), all ended with their first process.

    Root makes them as root, others inside a user namespace where that is allowed. Raises RunnerError where neither is allowed.
    """
    prefix = ["unshare", "--fork", "--kill-child=KILL", *(f"--{n}" for n in namespaces)]
    for attempt in (prefix, [*prefix, "--user", "--map-root-user"])[: 1 + allow_user]:
        if works([*attempt, "true"]):
            return attempt
    raise RunnerError(f"this machine refuses new {', '.join(namespaces)} namespaces (unshare)")


def works(argv: Sequence[str]) -> bool:
    """Whether a probe exits with status 0."""
    try:
        return subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True).returncode == 0
    except OSError:
        return False


def die_with_parent(with_signal: int = signal.SIGKILL) -> None:
    """Have the kernel send us a signal when our parent ends (for ``preexec_fn``)."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, with_signal)


@contextmanager
def started(argv: Sequence[str], **popen: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A running child; when the block is left, it and all its descendants have ended."""
    # What is ignored stays so: nohup ignores SIGHUP, and & in a script SIGINT.
    heeded = [n for n in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGQUIT) if signal.getsignal(n) != signal.SIG_IGN]
    before = [(number, signal.signal(number, _leave)) for number in heeded]
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    try:  # a signal may come before the child is known here
        yield subprocess.Popen(argv, start_new_session=True, preexec_fn=die_with_parent, **popen)  # noqa: PLW1509 (no threads)
    finally:
        for number, _ in before:
            signal.signal(number, signal.SIG_IGN)  # the sweep is short and must be whole
        _sweep()
        for number, handler in before:
            signal.signal(number, handler)


def run(argv: Sequence[str], timeout_s: float | None = None) -> int:
    """Run a command to its end and return its status as a shell would put it; 124 after a timeout."""
    with started(argv) as child:
        try:
            status = child.wait(timeout_s)
        except subprocess.TimeoutExpired:
            say(f"timed out after {timeout_s:g} s")
            return TIMED_OUT
    return status if status >= 0 else 128 - status


def _leave(number: int, _frame: object) -> None:
    raise SystemExit(128 + number)


def _sweep() -> None:
    """Kill and reap children until none is left; as a subreaper we inherit what they leave."""
    while children := _children():
        for pid in children:
            os.kill(pid, signal.SIGKILL)  # not reaped yet, so the number is still its own
        os.waitpid(children[0], 0)


def _children() -> list[int]:
    """Our children, living or not yet reaped."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = stat.read_text().rpartition(")")[2].split()[1]
        except OSError:  # it has just ended
            continue
        if int(parent) == os.getpid():
            found.append(int(stat.parent.name))
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """A command that wants a vcan0.

    Attributes:
        command: what to execute, with its arguments.
        backend: "native", "uml" or "debian"; "auto" takes the first that this machine has.
        virtual_time: the clock jumps to the next timer; only "uml" can.
        writable: absolute directories in which the command's files stay.
        source: archive of Linux 6.12 to build from in place of Debian's package.
        install: Debian packages that are missing may be installed.
        verbose: say which kernel is used.
    """

    command: tuple[str, ...]
    backend: str = "auto"
    virtual_time: bool = False
    writable: tuple[str, ...] = ()
    source: Path | None = None
    install: bool = False
    verbose: bool = False
