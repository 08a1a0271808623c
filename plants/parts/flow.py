"""The exact motion of a linear system under a held input, in plain floats; and what happens meanwhile: jumps, new noise."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final, Protocol

import numpy as np

from plants.errors import PlantError
from plants.parts import NEVER_NS, NS_PER_S
from plants.parts.draws import Normals, exponential
from plants.parts.exponential import Rows, dot, drift, zero_order_hold
from plants.parts.semi_markov import TransitionRates

_CACHED_STEPS = 64  # a rig uses one or two lengths; the bound only stops a caller that uses a new one every time


class Flow:
    """The motion of x' = A x + B v under a held v, exact for any length of time.

    Args:
        A: n x n rows.
        B: n x m rows; what is held is the one vector v (inputs and, where there are any, disturbances).
    """

    __slots__ = ("_A", "_B", "_norm", "_steps")

    def __init__(self, A: Sequence[Sequence[float]], B: Sequence[Sequence[float]]) -> None:
        self._A: Rows = tuple(tuple(float(a) for a in row) for row in A)
        self._B: Rows = tuple(tuple(float(b) for b in row) for row in B)
        self._norm = max(math.fsum(map(abs, row)) for row in self._A)
        self._steps: dict[int, Rows] = {}

    def prepare(self, dt_ns: int) -> None:
        """Compute the matrix of a length that will come, so that no later `step` has to (it takes up to 1 ms)."""
        if dt_ns not in self._steps:
            self._tabulate(dt_ns)

    def rows(self, dt_ns: int) -> Rows:
        """Return the rows of that matrix: x after dt_ns is, from the left, the sum of their products with x and v."""
        return self._steps.get(dt_ns) or self._tabulate(dt_ns)

    def step(self, x: Sequence[float], v: Sequence[float], dt_ns: int) -> list[float]:
        """Return x after dt_ns, by a matrix that is computed once for every length: for the sample period."""
        rows, held = self.rows(dt_ns), (*x, *v)
        after = []
        for row in rows:
            total = 0.0
            for a, b in zip(row, held):
                total += a * b
            after.append(total)
        return after

    def drift(self, x: Sequence[float], v: Sequence[float], dt_ns: int) -> list[float]:
        """Return x after dt_ns, by a series: for the odd lengths between random events."""
        return drift(self._A, self._norm, x, [dot(row, v) for row in self._B], dt_ns / NS_PER_S)

    def _tabulate(self, dt_ns: int) -> Rows:
        if dt_ns < 0:
            raise PlantError(f"advance: {dt_ns} ns, expected a time that does not run backwards")
        if len(self._steps) >= _CACHED_STEPS:
            self._steps.clear()
        Phi, Gamma = zero_order_hold(self._A, self._B, (dt_ns, NS_PER_S))
        rows = tuple(p + g for p, g in zip(Phi, Gamma))
        self._steps[dt_ns] = rows
        return rows


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
            self.next_ns = NEVER_NS

    def fire(self) -> None:
        """Take the next sample."""
        self.values = tuple(self._std * x for x in self._normals.several(self._size))
        self.next_ns += self._period_ns


class _Hazard:
    """The rate of leaving one mode, its integral and the inverse of that."""

    __slots__ = ("_areas", "_nodes", "_rates", "_slopes")

    def __init__(self, rates: TransitionRates, mode: int) -> None:
        self._nodes = rates.nodes_s
        self._rates = [math.fsum(rates.at(mode, h)) for h in rates.nodes_s]
        self._slopes, self._areas = [], [0.0]
        for (h0, h1), (r0, r1) in zip(pairwise(self._nodes), pairwise(self._rates)):
            self._slopes.append((r1 - r0) / (h1 - h0))
            self._areas.append(self._areas[-1] + 0.5 * (r0 + r1) * (h1 - h0))
        self._slopes.append(0.0)

    def integral(self, h: float) -> float:
        k = bisect_right(self._nodes, h) - 1
        d = h - self._nodes[k]
        return self._areas[k] + d * (self._rates[k] + 0.5 * self._slopes[k] * d)

    def inverse(self, area: float) -> float:
        k = bisect_right(self._areas, area) - 1
        rest, rate, slope = area - self._areas[k], self._rates[k], self._slopes[k]
        root = rate + math.sqrt(max(0.0, rate * rate + 2.0 * slope * rest))
        return self._nodes[k] + 2.0 * rest / root if root > 0.0 else self._nodes[k] if rest == 0.0 else math.inf


class JumpProcess:
    """A running semi-Markov process: the mode now, and the exact instant of the next jump.

    The integrated rate out of a mode, H(h), is a standard exponential variable at the jump. So one draw E gives the
    sojourn time H^-1(E), to the nanosecond, and the target is drawn with probability lambda_ij(h) / sum_j lambda_ij(h).

    Args:
        rates: the transition rates.
        mode: mode at time 0, where the sojourn clock is 0 too; counted from 1.
        rng: all randomness.
    """

    __slots__ = ("_hazards", "_rates", "_rng", "_target", "mode", "next_ns", "since_ns")

    def __init__(self, rates: TransitionRates, mode: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self.mode = mode
        self.since_ns = 0
        self._target = 0.0
        self._load(rates)
        self._draw()

    def fire(self) -> None:
        """Jump at ``next_ns``, and draw when the next one comes."""
        h = (self.next_ns - self.since_ns) / NS_PER_S
        rates = self._rates.at(self.mode, h)
        pick = self._rng.random() * math.fsum(rates)
        for j, rate in enumerate(rates, start=1):
            if rate > 0.0:
                self.mode = j
                pick -= rate
                if pick < 0.0:
                    break
        self.since_ns = self.next_ns
        self._draw()

    def change_rates(self, rates: TransitionRates, now_ns: int, *, restart: bool) -> None:
        """Let other rates govern the jump that is under way; what of E is used up stays used up.

        Args:
            rates: the new rates, of as many modes.
            now_ns: the present instant.
            restart: whether the sojourn clock starts again.
        """
        left = max(0.0, self._target - self._hazards[self.mode].integral((now_ns - self.since_ns) / NS_PER_S))
        self._load(rates)
        if restart:
            self.since_ns = now_ns
        self._target = left + self._hazards[self.mode].integral((now_ns - self.since_ns) / NS_PER_S)
        self._schedule(now_ns)

    def _load(self, rates: TransitionRates) -> None:
        self._rates = rates
        self._hazards = {mode: _Hazard(rates, mode) for mode in range(1, rates.modes + 1)}

    def _draw(self) -> None:
        self._target = exponential(self._rng)
        self._schedule(self.since_ns)

    def _schedule(self, now_ns: int) -> None:
        h = self._hazards[self.mode].inverse(self._target)
        # A jump takes place on the nanosecond grid of the rig, and always after now.
        instant = self.since_ns + round(h * NS_PER_S) if h < 1e9 else NEVER_NS
        self.next_ns = max(instant, now_ns + 1)
