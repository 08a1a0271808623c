"""Ctrl-C and its kin as an exception, and never one that an import swallows.

Some extension modules pass over whatever arises while they are imported: numpy.random does, for the few milliseconds of its
import. A signal that comes inside an import is raised as soon as the import is over. So is one that comes inside a `__del__`,
whose exceptions Python prints and drops.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final, NoReturn

from hil.plugins.first_instants import ENDING, leave_at_once

LONGEST_IMPORT_S: Final = 0.8
"""After so long a signal is raised inside an import also: within a second, everything stops."""

_AGAIN_S: Final = 0.005

_held: Final[list[int]] = []
_theirs: Final[list[Any]] = []
"""Handler and timer of SIGALRM before a signal was held."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, SIGHUP or SIGQUIT, raised where Ctrl-C would be: everything is taken down in order.

    Args:
        number: which.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.status = 128 + number


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
        if _swallowed(frame) and time.monotonic() < end:
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


def _swallowed(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib") or frame.f_code.co_name == "__del__":
            return True
        frame = frame.f_back
    return False
