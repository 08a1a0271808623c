"""The event kernel: handlers run in the order ``(t_ns, phase, seq)`` and receive their *nominal* time."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from enum import IntEnum
from itertools import count

from hil.runtime.time.clock import Clock

Handler = Callable[[int], None]


class Phase(IntEnum):
    """What happens first at one instant."""

    SENSE = 0  # the plant reaches the instant and is measured
    EXCHANGE = 1  # sensor packets out, the controller's answer in
    ACTUATE = 2  # the actuator applies a row
    RECORD = 3  # everybody else


class Kernel:
    """A heap of events on a clock.

    >>> from hil.runtime.time.clock import VirtualClock
    >>> k, seen = Kernel(VirtualClock()), []
    >>> k.at(10, Phase.ACTUATE, lambda t: seen.append(("act", t)))
    >>> k.at(10, Phase.SENSE, lambda t: seen.append(("sense", t)))
    >>> k.run(); seen
    [('sense', 10), ('act', 10)]
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._heap: list[tuple[int, int, int, Handler]] = []
        self._seq = count()
        self._stopped = False

    def at(self, t_ns: int, phase: Phase, handler: Handler) -> None:
        """Run ``handler(t_ns)`` once at ``t_ns``."""
        heapq.heappush(self._heap, (t_ns, phase, next(self._seq), handler))

    def every(self, period_ns: int, times: int, phase: Phase, handler: Handler) -> None:
        """Run ``handler`` at 0, ``period_ns``, ... : ``times`` times."""
        heap, seq = self._heap, self._seq
        last = (times - 1) * period_ns

        def again(t_ns: int) -> None:
            handler(t_ns)
            if t_ns < last:
                heapq.heappush(heap, (t_ns + period_ns, phase, next(seq), again))

        self.at(0, phase, again)

    @property
    def stopped(self) -> bool:
        """Whether :meth:`stop` was called."""
        return self._stopped

    def stop(self) -> None:
        """Run no further event (safe in a signal handler)."""
        self._stopped = True

    def run(self) -> None:
        """Run until no event is left, or :meth:`stop`."""
        heap, wait, pop = self._heap, self.clock.wait_until, heapq.heappop
        while heap and not self._stopped:
            wait(heap[0][0])
            if self._stopped:
                return
            t_ns, _, _, handler = pop(heap)
            handler(t_ns)
