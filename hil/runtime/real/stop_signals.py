"""SIGINT, SIGTERM and SIGHUP as a request to stop in order, so that every log is closed."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable


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
        self._old: dict[int, object] = {}

    def __enter__(self) -> StopSignals:
        if threading.current_thread() is threading.main_thread():  # no other thread may set handlers, and none gets a signal
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                self._old[number] = signal.signal(number, self._see)
        return self

    def _see(self, number: int, _frame: object) -> None:
        self.seen = self.seen or number
        self._told(number)

    def __exit__(self, *_: object) -> None:
        for number, handler in self._old.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
