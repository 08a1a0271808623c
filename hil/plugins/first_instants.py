"""The first instants of a command: its import takes a tenth of a second, in which Python answers a signal by a traceback."""

from __future__ import annotations

import gc
import os
import signal
from types import FrameType
from typing import Final, NoReturn

ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that ask a command to end."""


def leave_at_once(number: int, _frame: FrameType | None) -> NoReturn:
    """End this process with the status of a signal; for while there is nothing to take down.

    Args:
        number: the signal.
    """
    os._exit(128 + number)


def heed_signals() -> None:
    """Let every signal that ends a command end this process at once, except those that are handled or ignored."""
    for number in ENDING:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):  # nohup ignores SIGHUP
            signal.signal(number, leave_at_once)


def pass_over_signals() -> None:
    """Let no signal end this process any more: its work is done, its status stands, and Python takes its handlers away."""
    for number in ENDING:
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_IGN)


def collect_garbage_again() -> None:
    """Let Python look for garbage again, where `hil` started without, and never among what its modules left."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
