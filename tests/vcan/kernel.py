"""Which user-mode kernel to boot: the small one from the cache, built there when it is missing, or Debian's."""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from .supervise import RunnerError, say, started

HERE = Path(__file__).parent
SOURCE_PACKAGE = "linux-source-6.12"
SOURCE = Path(f"/usr/src/{SOURCE_PACKAGE}.tar.xz")
BUILD_PACKAGES = [SOURCE_PACKAGE, "gcc", "make", "flex", "bison", "bc", "libelf-dev", "xz-utils"]
STEPS = 1170  # lines that make prints for this configuration, for the progress line only

DEBIAN = Path("/usr/bin/linux.uml")
DEBIAN_MODULES = Path("/usr/lib/uml/modules")
DEBIAN_PACKAGES = ["user-mode-linux", "kmod"]
# What the small kernel has built in; modules that a Debian version lacks are left out.
NEEDED_MODULES = ["overlay", "ipv6", "vcan", "can-raw", "can-bcm", "sch_tbf", "sch_netem"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Kernel:
    """A user-mode kernel: its binary, the modules to load (dependencies first), and what it is called."""

    path: Path
    backend: str
    modules: tuple[Path, ...] = ()

    def describe(self) -> str:
        """One line for people."""
        kind = "our small user-mode kernel" if self.backend == "uml" else "Debian's user-mode kernel"
        return f"{kind} {_version(self.path)} ({self.path})"


def small() -> Kernel:
    """The small kernel from the cache; built first (some minutes) where it is not there. Raises RunnerError."""
    _need_machine_and_ip()
    path = _cached()
    if not path.exists():
        with _build_lock(path.parent):
            if not path.exists():  # the run that held the lock may have built it
                _install(BUILD_PACKAGES)
                path = _cached()  # the source's version is known only now
                _build(path)
    return Kernel(path=path, backend="uml")


def debian() -> Kernel:
    """Debian's ready package: slower, and without virtual time. Raises RunnerError."""
    _need_machine_and_ip()
    _install(DEBIAN_PACKAGES)
    base = DEBIAN_MODULES / _version(DEBIAN)
    needs = {}  # module name -> its files, itself first and what it depends on after
    for line in (base / "modules.dep").read_text().splitlines():
        file, _, rest = line.partition(":")
        needs[Path(file).stem] = [base / file, *(base / n for n in rest.split())]
    files = [file for name in NEEDED_MODULES for file in reversed(needs.get(name, []))]
    return Kernel(path=DEBIAN, backend="debian", modules=tuple(dict.fromkeys(files)))


def cache_directory() -> Path:
    """Where built kernels are kept: outside the repository, so that every clone uses the same."""
    base = os.environ.get("HILRIG_KERNEL_CACHE") or os.environ.get("XDG_CACHE_HOME")  # the first: tests have a cache of their own
    return Path(base or Path.home() / ".cache") / "hilrig"


def _cached() -> Path:
    """The small kernel's place: named after what it is made of, so that a stale one is never used.

    Without the source package any version built from this configuration will do.
    """
    recipe = hashlib.sha256((HERE / "kernel.config").read_bytes() + (HERE / "build_kernel").read_bytes())
    stem = f"linux-vcan-{recipe.hexdigest()[:12]}-"
    if not SOURCE.exists():
        return max(cache_directory().glob(f"{stem}*"), default=cache_directory() / f"{stem}none")
    return cache_directory() / f"{stem}{_source_version()}"


def _source_version() -> str:
    query = ["dpkg-query", "-W", "-f", "${Version}", SOURCE_PACKAGE]
    return subprocess.run(query, check=True, capture_output=True, text=True).stdout


def _build(path: Path) -> None:
    """Build into `path`, all at once or not at all; the lock is ours."""
    directory = path.parent
    new, log = directory / "kernel.new", directory / "build.log"
    argv = ["nice", str(HERE / "build_kernel"), str(SOURCE), str(directory / "build"), str(new)]
    begin = time.monotonic()
    say(f"building a small kernel with vcan, once, some minutes ({path})")
    with (
        log.open("wb") as errors,
        started(argv, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors) as make,
    ):
        assert make.stdout is not None
        _show_progress(make.stdout)
        failed = make.wait() != 0
    shutil.rmtree(directory / "build", ignore_errors=True)
    if failed:
        raise RunnerError(f"the kernel's build failed; see {log}:\n{log.read_text(errors='replace')[-2000:]}")
    new.rename(path)
    say(f"kernel built in {time.monotonic() - begin:.0f} s")


def _show_progress(lines: Iterable[bytes]) -> None:
    """A line that moves on a terminal, one every 30 s elsewhere."""
    begin = shown = time.monotonic()
    terminal = sys.stderr.isatty()
    for number, _ in enumerate(lines):
        now = time.monotonic()
        if now - shown > (0.2 if terminal else 30):
            shown = now
            text = f"with_vcan: kernel {min(99, 100 * number // STEPS)} %, {now - begin:.0f} s"
            print(f"\r{text}" if terminal else text, end="" if terminal else "\n", file=sys.stderr, flush=True)
    if terminal:
        print("\r", end="", file=sys.stderr)


@contextmanager
def _build_lock(directory: Path) -> Iterator[None]:
    """One build at a time; a killed one leaves no lock, and its half-built tree is the next one's to remove."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as why:
        raise RunnerError(f"no place to keep a kernel ({why}): set XDG_CACHE_HOME") from why
    with (directory / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another run is building the kernel; waiting for it")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _install(packages: list[str]) -> None:
    """Have Debian's packages, or raise RunnerError with the command to type."""
    done = subprocess.run(
        [str(HERE / "apt_install"), *packages], stdin=subprocess.DEVNULL, stdout=sys.stderr, stderr=subprocess.PIPE
    )
    if done.returncode:
        raise RunnerError(done.stderr.decode(errors="replace").strip().splitlines()[-1])


def _version(kernel: Path) -> str:
    return subprocess.run([kernel, "--version"], check=True, capture_output=True, text=True).stdout.strip()


def _need_machine_and_ip() -> None:
    if platform.machine() != "x86_64" or sys.platform != "linux":
        raise RunnerError(f"user-mode Linux needs x86-64 Linux, this is {sys.platform} on {platform.machine()}")
    if not shutil.which("ip"):
        _install(["iproute2"])
