"""The processes of a session: how they start, and the sequence that ends them: asked, given a moment together, killed.

Such a process runs ``python -m hil.runtime.real.child MODULE``, with its job, pickled, on standard input.
"""

from __future__ import annotations

import gc
import os
import pickle
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from math import inf
from typing import IO, Final

from hil.errors import collect_garbage_again, warn_in_one_line
from hil.runtime.clock import monotonic_ns

PYTHON: Final = (sys.executable, "-P")
"""Python that does not look into its working folder, where a ``pickle.py`` would stand before the standard library's."""


def python_module(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module that is installed.

    No folder of the user stands on its path before what is installed.

    Args:
        module: its full name.
        arguments: what follows.

    >>> python_module("hil", "--version")[1:]
    ['-P', '-m', 'hil', '--version']
    """
    return [*PYTHON, "-m", module, *arguments]


GRACE_S = 0.4  # SIGTERM to SIGKILL; with the rest it keeps a stop below one second
LAST_LOOK_S = 0.05
LOOK_MS = 50


class Child:
    """One process of the session; ended by :func:`end_all`, whatever it does.

    Args:
        name: what messages call it.
        module: what it runs: its ``main`` gets the job.
        job: what it reads, pickled, from its standard input.
        pass_fds: what it inherits.
        dump: pickles the job.
        folders: of modules that it may need to read the job; they stand behind everything that is installed.
    """

    def __init__(
        self,
        name: str,
        module: str,
        job: object,
        pass_fds: tuple[int, ...] = (),
        dump: Callable[[object, IO[bytes]], None] = pickle.dump,
        folders: Sequence[str] = (),
    ) -> None:
        self.name = name
        # A new session keeps the terminal's Ctrl-C away: this process ends its children in order.
        # It ignores SIGINT; blocked, one that comes before it has said so waits for that, and no import is cut off.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process = subprocess.Popen(
                python_module(__name__, module, *folders),
                stdin=subprocess.PIPE,
                stdout=sys.stderr.fileno() if _has_fileno(sys.stderr) else subprocess.DEVNULL,
                pass_fds=pass_fds,
                start_new_session=True,
                env=_environment(),
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        assert self._process.stdin is not None
        try:
            dump(job, self._process.stdin)
            self._process.stdin.close()
        except BrokenPipeError:
            pass  # it died on its first line; its status says so
        try:
            self._ended = select.poll()
            self._pidfd: int | None = os.pidfd_open(self._process.pid)
            self._ended.register(self._pidfd, select.POLLIN)
        except OSError:  # an old kernel, or no free descriptor: Python looks again and again
            self._pidfd = None

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def poll(self) -> int | None:
        """Return the exit status, None while it runs."""
        return self._process.poll()

    def how(self) -> str:
        """Say how the process ended."""
        status = self._process.returncode
        if status is not None and status < 0:
            return f"the {self.name} process (pid {self.pid}) was killed by {signal.Signals(-status).name}"
        return f"the {self.name} process (pid {self.pid}) ended with status {status}"

    def terminate(self) -> None:
        """Ask it to end."""
        if self.poll() is None:
            self._process.terminate()

    def wait(self, timeout_s: float) -> bool:
        """Return whether it has ended within ``timeout_s``, as soon as it has."""
        if self._pidfd is not None:
            self._ended.poll(timeout_s * 1e3)
            timeout_s = 0.0
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        self._let_go()
        return True

    def kill(self) -> None:
        """End it for certain: nothing outlives SIGKILL, not even what is stopped."""
        self._process.kill()
        self._process.wait()
        self._let_go()

    def _let_go(self) -> None:
        if self._pidfd is not None:
            os.close(self._pidfd)
            self._pidfd = None


def run_job(module: str, folders: Sequence[str]) -> None:
    """Run, in a `Child`, the job that it was given.

    Args:
        module: its ``main`` takes the job.
        folders: of modules that it may need to read the job.
    """
    gc.disable()  # to look for garbage among modules takes a tenth of its start
    sys.path.extend(folder for folder in folders if folder not in sys.path)
    warn_in_one_line()
    run = import_module(module).main
    collect_garbage_again()
    try:
        job = pickle.load(sys.stdin.buffer)
    except (EOFError, pickle.UnpicklingError):
        sys.exit(1)  # the session ended before it had said what to run
    run(job)


def _environment() -> dict[str, str]:
    """Return the environment of a child: no loop has matrices for a second BLAS thread, whose 40 MB it would lock (35 ms)."""
    own = {name: value for name, value in os.environ.items() if name != "PYTHONINSPECT"}  # it would wait for more
    return {"OPENBLAS_NUM_THREADS": "1", **own}


def _has_fileno(stream: object) -> bool:
    try:
        stream.fileno()  # type: ignore[attr-defined]
    except (OSError, AttributeError, ValueError):
        return False
    return True


def end_all(children: Sequence[Child], now_ns: Callable[[], int] = monotonic_ns) -> None:
    """End processes: SIGTERM to all, `GRACE_S` for all of them together, SIGKILL to what is left.

    Args:
        children: the processes; those that have ended already are joined. One whose turn comes late has `LAST_LOOK_S` left.
        now_ns: a monotonic clock.
    """
    for child in children:
        child.terminate()
    limit = now_ns() + round(GRACE_S * 1e9)
    for child in children:
        if not child.wait(max((limit - now_ns()) / 1e9, LAST_LOOK_S)):
            child.kill()


def is_open(fd: int) -> None:
    """Say to the other process of a session that this one's end of the link is open.

    Args:
        fd: of a socket to the other process; -1 for none.
    """
    if fd >= 0:
        with suppress(OSError):
            os.write(fd, b"o")


def other_is_open(fd: int, timeout_s: float = inf, stopped: Callable[[], bool] = lambda: False) -> bool:
    """Wait until the other process has said `is_open`; return False where it has ended, or the time is up.

    Args:
        fd: of a socket to the other process; -1 for none.
        timeout_s: how long to wait, s.
        stopped: whether this process is to end.
    """
    if fd < 0:
        return True
    said, limit = select.poll(), monotonic_ns() + 1e9 * timeout_s
    said.register(fd, select.POLLIN)
    with suppress(OSError):
        while not stopped() and monotonic_ns() < limit:
            if said.poll(LOOK_MS):
                return bool(os.read(fd, 1))
    return False


def is_stopped(pid: int) -> bool:
    """Return whether a process is stopped (SIGSTOP, a debugger); not if there is none.

    To be asked often: a `Path` would put its parts into Python's table of strings each time, and after minutes that table is made
    anew, twice as large.
    """
    try:
        with open(f"/proc/{pid}/stat", "rb", buffering=0) as file:
            return file.read(4096).rpartition(b")")[2].split()[0] in (b"T", b"t")
    except (OSError, IndexError):
        return False


if __name__ == "__main__":
    run_job(sys.argv[1], sys.argv[2:])
