"""A limit on the work of one input, which does not judge a busy machine wrongly."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

WORK_S, WAITING_S = 5.0, 120.0


class Hangs(BaseException):
    """An input took too long; no reader catches it."""


@contextmanager
def within(work_s: float = WORK_S, waiting_s: float = WAITING_S) -> Iterator[None]:
    """Fail where the work hangs: after so many seconds of CPU time, or where it waits for ever.

    The first is hundreds of times what the work takes, however busy the machine is.
    """

    def late(number: int, _frame: object) -> None:
        raise Hangs(f"not done in {work_s} s of work" if number == signal.SIGPROF else "waits for ever")

    before = {number: signal.signal(number, late) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, work_s)
    signal.setitimer(signal.ITIMER_REAL, waiting_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
