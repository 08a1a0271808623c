"""SIGINT, SIGTERM and SIGHUP as a request to stop in order, so that every log is closed.

A signal that is ignored when a session begins stays ignored: ``nohup`` ignores SIGHUP, ``command &`` in a script SIGINT.
SIGTERM then still stops the session.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any


class StopSignals:
    """While it is open, the first of these signals is kept and told, instead of ending the process where it stands.

    Args:
        told: called in the signal handler, with the signal's number.

    >>> with StopSignals() as signals:
    ...     signal.raise_signal(signal.SIGTERM)
    >>> signals.seen == signal.SIGTERM
    True
    """

    def __init__(self, told: Callable[[int], None] = lambda number: None) -> None:
        self.seen: int | None = None
        self._told = told
        self._old: dict[int, Any] = {}

    def __enter__(self) -> StopSignals:
        if threading.current_thread() is threading.main_thread():  # no other thread may set handlers, and none gets a signal
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                if (before := signal.getsignal(number)) != signal.SIG_IGN:
                    self._old[number] = before
                    signal.signal(number, self._see)
        return self

    def _see(self, number: int, _frame: object) -> None:
        self.seen = self.seen or number
        self._told(number)

    def __exit__(self, *_: object) -> None:
        for number, handler in self._old.items():
            signal.signal(number, handler)
