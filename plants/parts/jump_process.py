"""A running semi-Markov process, sampled without time steps."""

from __future__ import annotations

import math
from bisect import bisect_right
from itertools import pairwise

import numpy as np

from plants.parts.draws import exponential
from plants.parts.linear import NEVER_NS, NS_PER_S
from plants.parts.semi_markov import TransitionRates


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
