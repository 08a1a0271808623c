"""Which user-mode kernel to boot: the small one from the cache, built there when it is missing, or Debian's.

A build needs packages of Debian, installed only where that was asked for.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hil.vcan.supervise import RunnerError, Wanted, say, started

PROGRAMS: Final = {"xz-utils": "xz", "iproute2": "ip", "user-mode-linux": "linux.uml", "kmod": "kmod"}
"""Programs of a package that has another name."""


def need(packages: Sequence[str], *, install: bool) -> None:
    """Have Debian's packages, or raise with what to type.

    Args:
        packages: their names.
        install: install what is missing, as root.

    Raises:
        RunnerError: what is missing, and the command that helps.
    """
    missing = [package for package in packages if not _is_here(package)]
    if not missing:
        return
    names = " ".join(missing)
    how = f"apt-get update && apt-get install --no-install-recommends {names}"
    if not shutil.which("apt-get"):
        raise RunnerError(f"missing here: {names} (Debian's names; this is no Debian)")
    if os.geteuid() != 0:
        raise RunnerError(f"missing here: {names}. As root: {how}")
    if not install:
        raise RunnerError(f"missing here: {names}. Let them be installed with --install, or: {how}")
    say(f"installing {names}")
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environ = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for step in (["update"], ["install", "-y", "--no-install-recommends", *missing]):
        if subprocess.run(["apt-get", *step], env=environ, **quiet).returncode:  # type: ignore[call-overload]
            raise RunnerError(f"could not install {names} (offline?). Once there is a mirror: {how}")


def _is_here(package: str) -> bool:
    """Whether a package is installed; elsewhere than on Debian its program must do, and a library is left to the build."""
    if not shutil.which("dpkg-query"):
        return package.startswith("lib") or shutil.which(PROGRAMS.get(package, package)) is not None
    query = ["dpkg-query", "-W", "-f", "${Status}", package]
    return subprocess.run(query, capture_output=True, text=True).stdout.endswith(" installed")


HERE: Final = Path(__file__).parent
SOURCE_PACKAGE: Final = "linux-source-6.12"
SOURCE: Final = Path(f"/usr/src/{SOURCE_PACKAGE}.tar.xz")
BUILD_PACKAGES: Final = ["gcc", "make", "flex", "bison", "bc", "libelf-dev", "xz-utils"]
STEPS: Final = 1170  # lines that make prints for this configuration, for the progress line only

DEBIAN: Final = Path("/usr/bin/linux.uml")
DEBIAN_MODULES: Final = Path("/usr/lib/uml/modules")
DEBIAN_PACKAGES: Final = ["user-mode-linux", "kmod"]
# What the small kernel has built in; modules that a Debian version lacks are left out.
NEEDED_MODULES: Final = ["overlay", "ipv6", "vcan", "can-raw", "can-bcm", "sch_tbf", "sch_netem"]


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


def small(wanted: Wanted) -> Kernel:
    """Return the small kernel from the cache; it is built first (some minutes) where it is not there.

    Raises:
        RunnerError: what is missing for the build, or why it failed.
    """
    need_machine(install=wanted.install)
    path = _cached(wanted.source)
    if not path.exists():
        with _build_lock(path.parent) as lock:
            if not path.exists():  # the run that held the lock may have built it
                need_for_build(wanted.source, install=wanted.install)
                path = _cached(wanted.source)  # the source's version is known only now
                _build(path, wanted.source or SOURCE, lock)
    return Kernel(path=_of_ours(path), backend="uml")


def _of_ours(path: Path) -> Path:
    """Return a kernel that is kept, unless another user could have put it there: it runs with our rights."""
    for each in (path.parent, path):
        about = each.stat()
        if about.st_uid not in (0, os.geteuid()) or about.st_mode & stat.S_IWOTH:
            raise RunnerError(f"{each}: another user can write it, and it would run as you; remove it, or set XDG_CACHE_HOME")
    return path


def debian(wanted: Wanted) -> Kernel:
    """Return Debian's ready package: slower, and without virtual time.

    Raises:
        RunnerError: it is not installed.
    """
    need_machine(install=wanted.install)
    need(DEBIAN_PACKAGES, install=wanted.install)
    base = DEBIAN_MODULES / _version(DEBIAN)
    needs = {}  # module name -> its files, itself first and what it depends on after
    for line in (base / "modules.dep").read_text().splitlines():
        file, _, rest = line.partition(":")
        needs[Path(file).stem] = [base / file, *(base / n for n in rest.split())]
    files = [file for name in NEEDED_MODULES for file in reversed(needs.get(name, []))]
    return Kernel(path=DEBIAN, backend="debian", modules=tuple(dict.fromkeys(files)))


def built() -> Path | None:
    """Return the small kernel if it lies in the cache.

    Raises:
        RunnerError: there is no cache, or another user can write there.
    """
    path = _cached(None)
    return _of_ours(path) if path.exists() else None


def need_machine(*, install: bool) -> None:
    """Refuse a machine that cannot run user-mode Linux with a network in it.

    Args:
        install: install what is missing.

    Raises:
        RunnerError: it is no x86-64 Linux, or has no ``ip``.
    """
    if platform.machine() != "x86_64" or sys.platform != "linux":
        raise RunnerError(f"user-mode Linux needs x86-64 Linux, this is {sys.platform} on {platform.machine()}")
    if not shutil.which("ip"):
        need(["iproute2"], install=install)


def need_for_build(source: Path | None, *, install: bool = False) -> None:
    """Refuse where the small kernel cannot be built.

    Args:
        source: an archive of the kernel's source in place of Debian's package.
        install: install what is missing.

    Raises:
        RunnerError: what is missing, and what helps.
    """
    need_machine(install=install)
    packaged = [] if source is not None or SOURCE.exists() else [SOURCE_PACKAGE]
    try:
        need([*packaged, *BUILD_PACKAGES], install=install)
    except RunnerError as why:
        other = "; or --source FILE, an archive linux-6.12*.tar.xz" if packaged else ""
        raise RunnerError(f"{why}{other}") from why


def cache_directory() -> Path:
    """Where built kernels are kept: outside the repository, so that every clone uses the same.

    Raises:
        RunnerError: the user has no home, such as a container's unknown one.
    """
    base = os.environ.get("HILRIG_KERNEL_CACHE") or os.environ.get("XDG_CACHE_HOME")  # the first: tests have a cache of their own
    try:
        return Path(base or Path.home() / ".cache") / "hilrig"
    except RuntimeError as why:
        raise RunnerError(f"no place to keep a kernel ({why}): set XDG_CACHE_HOME") from why


def _cached(source: Path | None) -> Path:
    """The small kernel's place: named after what it is made of, so that a stale one is never used.

    Without the source any version built from this configuration will do.
    """
    recipe = hashlib.sha256((HERE / "kernel.config").read_bytes() + (HERE / "build_kernel").read_bytes())
    stem = f"linux-vcan-{recipe.hexdigest()[:12]}-"
    if source is not None:
        return cache_directory() / f"{stem}{source.name.removesuffix('.tar.xz')}-{source.stat().st_size}"
    if not SOURCE.exists():
        return max(cache_directory().glob(f"{stem}*"), default=cache_directory() / f"{stem}none")
    return cache_directory() / f"{stem}{_source_version()}"


def _source_version() -> str:
    query = ["dpkg-query", "-W", "-f", "${Version}", SOURCE_PACKAGE]
    try:
        return subprocess.run(query, check=True, capture_output=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError) as why:
        raise RunnerError(f"{SOURCE}: is of no package that dpkg-query knows; build from it with --source {SOURCE}") from why


def _build(path: Path, source: Path, lock: int) -> None:
    """Build into `path`, all at once or not at all; the build's processes hold the lock as long as one of them lives."""
    (tree, new), log = _half_built(), path.parent / "build.log"
    argv = ["nice", "sh", str(HERE / "build_kernel"), str(source), str(tree), str(new)]
    begin = time.monotonic()
    say(f"building a small kernel with vcan, once, some minutes ({path})")
    try:
        with (
            log.open("wb") as errors,
            started(argv, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors, pass_fds=(lock,)) as make,
        ):
            _show_progress(make.stdout or [])
            failed = make.wait() != 0
        if failed:
            last = log.read_text(errors="replace")[-2000:].strip()
            raise RunnerError(f"the kernel's build from {source} failed; see {log}:\n{last}")
        new.rename(path)
    finally:  # Ctrl-C and SIGTERM too; what SIGKILL leaves is the next run's to remove
        _remove_half_built()
    say(f"kernel built in {time.monotonic() - begin:.0f} s")


def _show_progress(lines: Iterable[bytes]) -> None:
    """A line that moves on a terminal, one every 30 s elsewhere."""
    begin = shown = time.monotonic()
    terminal = sys.stderr.isatty()
    for number, _ in enumerate(lines):
        now = time.monotonic()
        if now - shown > (0.2 if terminal else 30):
            shown = now
            done, spent = min(0.99, number / STEPS), now - begin
            left = f", about {spent / done - spent:.0f} s left" if done > 0.05 else ""
            text = f"hil vcan: kernel {100 * done:.0f} %, {spent:.0f} s{left}"
            sys.stderr.write(f"\r{text:<60}" if terminal else f"{text}\n")
            sys.stderr.flush()
    if terminal:
        sys.stderr.write("\r")


def clear_half_built() -> None:
    """Remove what a killed build has left in the cache (700 MB); one that still runs is left alone."""
    directory = cache_directory()
    if not any(place.exists() for place in _half_built()):
        return
    with suppress(OSError), (directory / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        say(f"removing what a killed build left in {directory}")
        _remove_half_built()


def _half_built() -> tuple[Path, Path]:
    return cache_directory() / "build", cache_directory() / "kernel.new"


def _remove_half_built() -> None:
    tree, new = _half_built()
    shutil.rmtree(tree, ignore_errors=True)
    new.unlink(missing_ok=True)


@contextmanager
def _build_lock(directory: Path) -> Iterator[int]:
    """One build at a time; gives the lock's file descriptor. A killed build leaves no lock."""
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
        yield lock.fileno()


def _version(kernel: Path) -> str:
    return subprocess.run([kernel, "--version"], check=True, capture_output=True, text=True).stdout.strip()
