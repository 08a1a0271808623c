"""How the processes of a session end: by signals, in order, with an exit status that their parent reads."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any, Final

from hil.plugins import WATCH
from transport.links import LinkCounters

STOPPING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_AGAIN_S: Final = 0.1


class Forced(KeyboardInterrupt):
    """What runs did not stop when it was asked to: raised in its midst."""


class StopSignals:
    """While it is open, the first of these signals is kept and handed on, instead of ending the process where it stands.

    SIGINT, SIGTERM, SIGHUP and SIGQUIT are requests to stop in order, so that every log is closed.

    A signal that is ignored when a session begins stays ignored: ``nohup`` ignores SIGHUP, ``command &`` in a script SIGINT.
    SIGTERM then still stops the session.

    Args:
        on_signal: called in the signal handler, with the signal's number.
        force_s: after so long `Forced` is raised where the main thread stands, at a second signal at once; None: never.

    >>> with StopSignals() as signals:
    ...     signal.raise_signal(signal.SIGTERM)
    >>> signals.seen == signal.SIGTERM
    True
    """

    def __init__(self, on_signal: Callable[[int], None] = lambda number: None, force_s: float | None = None) -> None:
        self.seen: int | None = None
        self._on_signal = on_signal
        self._force_s = force_s
        self._old: dict[int, Any] = {}

    def __enter__(self) -> StopSignals:
        if threading.current_thread() is threading.main_thread():  # no other thread may set handlers, and none gets a signal
            for number in STOPPING:
                if (before := signal.getsignal(number)) != signal.SIG_IGN:
                    self._old[number] = before
                    signal.signal(number, self._see)
            if self._force_s is not None:
                self._old[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._force)
        return self

    def _see(self, number: int, _frame: object) -> None:
        again, self.seen = self.seen is not None, self.seen or number
        self._on_signal(number)
        if self._force_s is None:
            WATCH.get().stopping()
        if self._force_s is not None:
            signal.setitimer(signal.ITIMER_REAL, 1e-6 if again else self._force_s, _AGAIN_S)

    def _force(self, _number: int, _frame: object) -> None:
        raise Forced

    def __exit__(self, *_: object) -> None:
        if signal.SIGALRM in self._old:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in self._old.items():
            signal.signal(number, handler)
        if self.seen is not None:
            WATCH.get().stopping()


NO_CONTROLLER: Final = 3
"""The rig: no controller answered."""
STOPPED: Final = 128 + signal.SIGTERM
"""The rig: SIGTERM ended it; of the session, or sent to this process alone."""
FAILED: Final = 4
"""The rig: a part of the loop failed in the run, as an event of the log says."""
ENDED: Final = 5
"""The rig: the run ended in order. 0 is what any code ends a process with."""


NO_ANSWER: Final = "no answer to this rig: another pad= or wire version, or a second rig is on the link"


def useless(counters: LinkCounters, others: int) -> int:
    """Return how many frames came on a link and were of no use; arguments as of `useless_frames`."""
    return counters.malformed + counters.foreign + counters.refused + others


def useless_frames(uri: str, counters: LinkCounters, others: int, what: str = NO_ANSWER) -> str:
    """Return how many frames came on a link and were of no use, why, and what helps; empty where none came.

    Args:
        uri: the link.
        counters: of its end.
        others: packets that the link handed over.
        what: these are.
    """
    came = (
        (counters.malformed, "malformed: another framing or wire version, give both ends the same fd= and pad="),
        (counters.foreign, "foreign: other CAN identifiers, or CAN FD where fd=0, give both ends the same base= and fd="),
        (counters.refused, "refused: without a valid code or certificate, give both ends the same auth= or keys="),
        (others, what),
    )
    total = useless(counters, others)
    return f"{total} frames came on {uri}: {'; '.join(f'{number} {why}' for number, why in came if number)}" if total else ""
