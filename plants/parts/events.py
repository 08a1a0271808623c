"""What happens inside an advance: instants at which a mode jumps or a noise sample changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np

from plants.errors import PlantError
from plants.parts.draws import Normals

MOST_EVENTS: Final = 100_000
"""So many in one advance are refused: what changes every few nanoseconds would hold a run for ever."""


class Source(Protocol):
    """Something that happens at ``next_ns``, and then knows when it happens next."""

    next_ns: int

    def fire(self) -> None:
        """Happen, at ``next_ns``; afterwards ``next_ns`` is later."""


def pass_time(now_ns: int, end_ns: int, sources: Sequence[Source], move: Callable[[int, int], None]) -> None:
    """Move from event to event, and to the end.

    What happens at the end itself happens before this returns, so that a measurement sees it and cutting time in two
    changes nothing. Of events at one instant the earlier source comes first.

    Args:
        now_ns: where time stands.
        end_ns: where it goes.
        sources: what may happen.
        move: called with the ends of every piece of time between two events.

    Raises:
        PlantError: there are more than `MOST_EVENTS`.
    """
    begin_ns = now_ns
    for _ in range(MOST_EVENTS):
        nearest: Source | None = None
        event_ns = end_ns
        for source in sources:
            if source.next_ns <= end_ns and (nearest is None or source.next_ns < event_ns):
                nearest, event_ns = source, source.next_ns
        if event_ns > now_ns:
            move(now_ns, event_ns)
            now_ns = event_ns
        if nearest is None:
            return
        nearest.fire()
    what = type(nearest).__name__
    raise PlantError(f"{what}: more than {MOST_EVENTS} changes in {(end_ns - begin_ns) / 1e9:g} s, too many to be run")


class HeldNoise:
    """White noise as a rig has it: independent normal samples, each held for one period.

    Over a bandwidth far below 1/period this is noise of spectral density std^2 period (two-sided, per Hz); it is the
    variance of the samples, not that density, that stays fixed when the period changes.

    Args:
        size: number of channels.
        std: standard deviation of a sample.
        period_ns: time between samples.
        rng: all randomness; nothing is drawn if std is 0.
    """

    __slots__ = ("_normals", "_period_ns", "_size", "_std", "next_ns", "values")

    def __init__(self, size: int, std: float, period_ns: int, rng: np.random.Generator) -> None:
        self._size, self._std, self._period_ns, self._normals = size, std, period_ns, Normals(rng)
        self.values: tuple[float, ...] = (0.0,) * size
        self.next_ns = 0
        if std > 0.0:
            self.fire()
        else:
            self.next_ns = 1 << 62

    def fire(self) -> None:
        """Take the next sample."""
        self.values = tuple(self._std * x for x in self._normals.several(self._size))
        self.next_ns += self._period_ns
