"""How a command ends: Ctrl-C and its kin as an exception, and no end in silence by a user's code.

Some extension modules pass over whatever arises while they are imported: numpy.random does, for the few milliseconds of its
import. A signal that comes inside an import is raised as soon as the import is over. So is one that comes inside a `__del__`,
whose exceptions Python prints and drops.

A module that an experiment names may end its process with status 0, close its output, or hang where no signal is received. From
its first line on the command runs in a child. The child says in a page of shared memory, which no closed descriptor takes away,
that the command is done and with which status. Without that word the status is never 0, and there is one message.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final, NoReturn

from hil.errors import ENDING, Terminated, leave_at_once
from hil.plugins import ProcessState

LONGEST_IMPORT_S: Final = 0.8
"""After so long a signal is raised inside an import also: within a second, everything stops."""

_AGAIN_S: Final = 0.005

_held: Final[list[int]] = []
_theirs: Final[list[Any]] = []
"""Handler and timer of SIGALRM before a signal was held."""


@contextmanager
def signals_as_exceptions() -> Iterator[None]:
    """Raise KeyboardInterrupt for SIGINT and `Terminated` for SIGTERM, SIGHUP and SIGQUIT, unless other code handles them.

    Raises:
        KeyboardInterrupt: SIGINT came.
        Terminated: SIGTERM, SIGHUP or SIGQUIT came.
    """
    plain = (signal.SIG_DFL, signal.default_int_handler, leave_at_once)  # nohup ignores SIGHUP, and & ignores SIGINT
    ours = {n: h for n in ENDING if (h := signal.getsignal(n)) in plain}
    for number in ours:
        signal.signal(number, _see)
    try:
        yield
    finally:
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, ours)  # what comes now comes when all is as it was
        for number, handler in ours.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if _held:  # its timer would end a process that has no handler left
            _raise(_released())


def _see(number: int, frame: FrameType | None) -> None:
    if not _swallowed(frame):
        _raise(number)
    _held.append(number)
    if len(_held) > 1:
        return
    end = time.monotonic() + LONGEST_IMPORT_S
    _theirs[:] = signal.getsignal(signal.SIGALRM), signal.getitimer(signal.ITIMER_REAL)

    def look(_number: int, frame: FrameType | None) -> None:
        if _swallowed(frame) and (time.monotonic() < end or _swallowed(frame, always=True)):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        _raise(_released())

    signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)


def _released() -> int:
    """Return the signal that was held; its timer is off, and SIGALRM is whose it was."""
    number = _held[0]
    signal.setitimer(signal.ITIMER_REAL, *_theirs[1])
    signal.signal(signal.SIGALRM, _theirs[0])
    _held.clear()
    return number


def _raise(number: int) -> NoReturn:
    raise KeyboardInterrupt if number == signal.SIGINT else Terminated(number)


def _swallowed(frame: FrameType | None, *, always: bool = False) -> bool:
    """Return whether what is raised in a frame may be dropped, or always is: in a callback of the import's own locks, too."""
    while frame is not None:
        importing, name = frame.f_code.co_filename.startswith("<frozen importlib"), frame.f_code.co_name
        if name == "__del__" or (importing and (name == "cb" or not always)):
            return True
        frame = frame.f_back
    return False


STOPS_S: Final = 1.0
"""From a signal to the end of a command that does not react to it."""
LEAVES_S: Final = 5.0
"""From the end of a command to the end of its threads and exit functions."""
CLOSES_S: Final = 10.0
"""From a signal that is heeded to the end: the log is closed and summed up, on a busy machine too."""

LOOK_S: Final = 0.1
BYTES: Final = 4096
DONE, STATUS, STOPPING, LENGTH, TEXT = 0, 1, 2, 3, 5  # places in the page
PR_SET_PDEATHSIG: Final = 1


class Guard:
    """Watches a command from its first user's module on; without one there is no second process.

    Args:
        at_first: how the process is when the command begins, and has to be when it ends.
    """

    def __init__(self, at_first: ProcessState) -> None:
        self._at_first = at_first
        self._page: mmap.mmap | None = None
        self._pid = 0

    def begin(self, module: str) -> None:
        """Go on in a child; the process that was called stays and watches.

        Args:
            module: whose first line is next.
        """
        if self._page is not None or threading.active_count() > 1:  # a fork has one thread
            return
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        self._page = mmap.mmap(-1, BYTES)
        watcher = os.getpid()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {*ENDING, signal.SIGCHLD})
        child = os.fork()
        if child:
            _watch(child, self._page, module)
        self._pid = os.getpid()
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if os.getppid() != watcher:
            os._exit(1)

    def end(self, status: int) -> None:
        """Say that the command is done.

        Args:
            status: its exit status.
        """
        if self._page is None or os.getpid() != self._pid:
            return
        unchanged = self._at_first.files[2] == ProcessState.now().files[2]
        changes = [] if status and unchanged else self._at_first.changes()  # what went wrong is said already
        self._at_first.restore()
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        said = "; ".join(changes).encode(errors="replace")[: BYTES - TEXT]
        self._page[LENGTH : TEXT + len(said)] = len(said).to_bytes(2, "little") + said
        self._page[STATUS] = status & 0xFF
        self._page[DONE] = 1  # last: what stands behind it is whole

    def stopping(self) -> None:
        """Say that a signal was heeded; see `hil.plugins`."""
        if self._page is not None:
            self._page[STOPPING] = 1


def _watch(child: int, page: mmap.mmap, module: str) -> NoReturn:
    """Wait for the child, hand signals on to it, and end as it did, or should have."""
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))  # a pipe that the child closes is closed
    ending = {number for number in ENDING if signal.getsignal(number) != signal.SIG_IGN}
    asked, limit, done, stopping = 0, float("inf"), False, False
    while True:
        pid, how = os.waitpid(child, os.WNOHANG)
        if pid:
            status = os.waitstatus_to_exitcode(how)
            break
        if page[STOPPING] and asked and not stopping:
            stopping, limit = True, time.monotonic() + CLOSES_S
        if page[DONE] and not done:
            done, limit = True, time.monotonic() + (STOPS_S if asked else LEAVES_S)
        if time.monotonic() > limit:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            status = -signal.SIGKILL
            break
        came = signal.sigtimedwait({*ending, signal.SIGCHLD}, LOOK_S)
        if came is not None and came.si_signo != signal.SIGCHLD:
            asked, limit = asked or came.si_signo, min(limit, time.monotonic() + STOPS_S)
            if came.si_code <= 0:  # of kill(2); a terminal's goes to the child as well
                os.kill(child, came.si_signo)
    _leave(status, asked, page, module)


def _leave(status: int, asked: int, page: mmap.mmap, module: str) -> NoReturn:
    reason = ""
    code = status if status >= 0 else 128 - status
    if page[DONE]:
        ended, code = code, page[STATUS]
        reason = page[TEXT : TEXT + int.from_bytes(page[LENGTH:TEXT], "little")].decode(errors="replace")
        if status == -signal.SIGKILL:
            if not reason and code != 128 + asked:  # an interrupt that was heeded is said, slow as the machine may be
                reason = "a thread or an exit function did not end, and was killed"
        elif ended != code and not reason:
            reason = f"an exit function ended the process with status {ended}"
        code = code or int(bool(reason))
    elif asked:
        code = 128 + asked
        reason = f"it did not react to {signal.Signals(asked).name} for {STOPS_S:g} s, and was killed" if status < 0 else ""
    elif status < 0:
        reason = f"the command was killed by {signal.Signals(-status).name} before it was done"
    else:
        reason = f"the process ended with status {status} before the command was done"
        code = code or 1
    if reason:
        with open(2, "w", closefd=False, errors="backslashreplace") as err:
            err.write(f"hil: {module}: {reason}\n")
    os._exit(code)
