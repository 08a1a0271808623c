"""The event kernel: handlers run in the order ``(t_ns, seq)`` and receive their *nominal* time."""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush
from itertools import count

from hil.runtime.time.clock import Clock

Handler = Callable[[int], None]


class Kernel:
    """A heap of events on a clock.

    Attributes:
        stopped: whether :meth:`stop` was called.

    >>> from hil.runtime.time.clock import VirtualClock
    >>> k, seen = Kernel(VirtualClock()), []
    >>> k.at(20, lambda t: seen.append(("later", t)))
    >>> k.at(10, lambda t: seen.append(("sooner", t)))
    >>> k.run(); seen
    [('sooner', 10), ('later', 20)]
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._heap: list[tuple[int, int, Handler, int, int]] = []  # instant, number, handler, period, last instant
        self._seq = count()
        self.stopped = False

    def at(self, t_ns: int, handler: Handler) -> None:
        """Run ``handler(t_ns)`` once at ``t_ns``."""
        heappush(self._heap, (t_ns, next(self._seq), handler, 0, t_ns))

    def every(self, period_ns: int, times: int, handler: Handler) -> None:
        """Run ``handler`` at 0, ``period_ns``, ... : ``times`` times."""
        heappush(self._heap, (0, next(self._seq), handler, period_ns, (times - 1) * period_ns))

    def stop(self) -> None:
        """Run no further event (safe in a signal handler)."""
        self.stopped = True

    def run(self) -> None:
        """Run until no event is left, or :meth:`stop`."""
        while self._heap and not self.stopped:
            self.clock.wait_until(self._heap[0][0])
            if self.stopped:
                return
            t_ns, _, handler, period_ns, last = heappop(self._heap)
            handler(t_ns)
            if t_ns < last:
                heappush(self._heap, (t_ns + period_ns, next(self._seq), handler, period_ns, last))
