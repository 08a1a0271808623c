"""Signals that end a process, held while something is made that has to be taken away again."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that ask a process to end; `hil.plugins.first_instants`, which imports no package of ours, has them too."""


@contextmanager
def signals_later() -> Iterator[None]:
    """Let no such signal come before the end of the block: what is made in it has its name by then, and can be taken away.

    The handlers wait, as a mask would hold for one thread only, and the libraries of linear algebra have threads of their own.
    """
    came: list[int] = []
    theirs = {number: handler for number in _ENDING if callable(handler := signal.getsignal(number))}
    for number in theirs:
        signal.signal(number, lambda number, _frame: came.append(number))
    try:
        yield
    finally:
        for number, handler in theirs.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
