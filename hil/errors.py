"""How hil and its commands end: the one error root, which the command line turns into a message and an exit status; and signals.

The import of a command takes a tenth of a second, in which Python answers a signal by a traceback: these are its first instants.
"""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final, NoReturn


class HilError(Exception):
    """Something the user can mend; the message names the object, the value and what was expected.

    Attributes:
        status: exit status on the command line.
    """

    status = 2


class Terminated(KeyboardInterrupt):
    """A signal that ends everything in order, such as SIGTERM, raised where Ctrl-C would be.

    Args:
        number: which.

    Attributes:
        status: exit status on the command line.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.status = 128 + number


def exit_status(interrupt: KeyboardInterrupt) -> int:
    """Return the exit status on the command line: 130 of Ctrl-C."""
    return interrupt.status if isinstance(interrupt, Terminated) else 130


def warn_in_one_line() -> None:
    """Let a warning of ours be its text alone from now on: no user of a command wrote the line of Python that it would name."""
    import warnings  # beside a run of Python alone

    plain = warnings.formatwarning

    def format_warning(message: Warning | str, *where: Any, **more: Any) -> str:
        return f"{message}\n" if str(message).startswith("hil: ") else plain(message, *where, **more)

    warnings.formatwarning = format_warning


@contextmanager
def located(where: object, *kinds: type[Exception], advice: str = "") -> Iterator[None]:
    """Raise a fault as a message that begins with where it is.

    Args:
        where: the file, the field, the option.
        kinds: of fault; of an OSError only its reason is given.
        advice: what helps.

    Raises:
        HilError: ``where: fault; advice``.
    """
    try:
        yield
    except kinds as error:
        fault = (error.strerror if isinstance(error, OSError) else "") or error
        raise HilError(f"{where}: {fault}" + (f"; {advice}" if advice else "")) from error


def is_message(error: type[BaseException]) -> bool:
    """Return whether an error is a message to the user: ours, or one of the other packages, which are not imported for a name."""
    return any(each.__name__ in ("HilError", "TransportError", "PlantError", "DesignError") for each in error.__mro__)


class DiskFull(HilError):
    """A disk that took not one record of a run; the command and its files are correct."""

    status = 1


class ExperimentError(HilError):
    """An experiment that cannot be run, with every fault that was found.

    Args:
        source: file or name of the experiment.
        faults: one line each, ``path.of.the.field: what is wrong``.
    """

    def __init__(self, source: str, faults: list[str]) -> None:
        self.source = source
        self.faults = faults
        super().__init__("\n".join(f"{source}: {fault}" for fault in faults))


def nearest(name: object, known: Iterable[str], *, lead: str = "; ", cutoff: float = 0.6) -> str:
    """Return what a message about an unknown name ends with: a question for the nearest known one, or nothing.

    Args:
        name: what was written.
        known: what could have been.
        lead: what joins the question to the message.
        cutoff: from 0, anything is near, to 1, only the same.

    >>> nearest("settling_tme_s", ["sse", "settling_time_s"])
    "; did you mean 'settling_time_s'?"
    """
    from difflib import get_close_matches

    near = get_close_matches(str(name)[:100], known if isinstance(known, list) else [*known], n=1, cutoff=cutoff)
    return f"{lead}did you mean {near[0]!r}?" if near else ""


class ForeignVerdict(Exception):
    """A verdict whose digest is not that of the loop it is shown for: a fault of the program, never of the user."""


class UnknownName(HilError, KeyError):
    """A name that is none of those that are there."""

    __str__ = Exception.__str__  # a KeyError would print its text in quotes


def unknown_name(what: str, name: object, known: Iterable[str]) -> UnknownName:
    """Return the error for a name, with the nearest one and all that are there.

    >>> print(unknown_name("metric", "settling_tme_s", ["sse", "settling_time_s"]))
    no metric is called 'settling_tme_s'; did you mean 'settling_time_s'? There are: sse, settling_time_s
    """
    names = list(known)
    return UnknownName(f"no {what} is called {str(name)!r}{nearest(name, names) or '.'} There are: {', '.join(names) or 'none'}")


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
