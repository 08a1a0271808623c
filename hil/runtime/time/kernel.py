"""The event kernel: handlers run in the order ``(t_ns, seq)`` and receive their *nominal* time."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from itertools import count

from hil.runtime.time.clock import Clock

Handler = Callable[[int], None]


class Kernel:
    """A heap of events on a clock.

    >>> from hil.runtime.time.clock import VirtualClock
    >>> k, seen = Kernel(VirtualClock()), []
    >>> k.at(20, lambda t: seen.append(("later", t)))
    >>> k.at(10, lambda t: seen.append(("sooner", t)))
    >>> k.run(); seen
    [('sooner', 10), ('later', 20)]
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._heap: list[tuple[int, int, Handler]] = []
        self._seq = count()
        self._stopped = False

    def at(self, t_ns: int, handler: Handler) -> None:
        """Run ``handler(t_ns)`` once at ``t_ns``."""
        heapq.heappush(self._heap, (t_ns, next(self._seq), handler))

    def every(self, period_ns: int, times: int, handler: Handler) -> None:
        """Run ``handler`` at 0, ``period_ns``, ... : ``times`` times."""
        heap, seq = self._heap, self._seq
        last = (times - 1) * period_ns

        def again(t_ns: int) -> None:
            handler(t_ns)
            if t_ns < last:
                heapq.heappush(heap, (t_ns + period_ns, next(seq), again))

        self.at(0, again)

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
            t_ns, _, handler = pop(heap)
            handler(t_ns)
