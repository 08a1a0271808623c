"""Semi-Markov mode processes: transition rates that depend on the time since the last jump, sampled without time steps."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from plants.errors import FieldError
from plants.parts.draws import exponential
from plants.parts.linear import NS_PER_S
from plants.parts.validation import SHORTEST_STEP_S, require_finite, require_not_negative, require_positive

NEVER_NS = 1 << 62

Generator = tuple[tuple[float, ...], ...]

MOST_RATE: Final = 1.0 / SHORTEST_STEP_S
"""Jumps in a second that a run can follow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TransitionRates:
    """Rates lambda_ij(h) in 1/s, piecewise linear in the sojourn time h and constant after the last node.

    Args:
        nodes_s: sojourn times in s, the first 0, increasing.
        rates: for every node one N x N matrix of rates, with the diagonal that makes its rows sum to 0.

    Raises:
        ValueError: where nodes or matrices do not fit (the message names the entry).

    Reference: thesis sec. 2.2; (2.26) is `clipped`.
    """

    nodes_s: tuple[float, ...]
    rates: tuple[Generator, ...]

    def __post_init__(self) -> None:
        if not self.nodes_s or self.nodes_s[0] != 0.0:
            raise FieldError("nodes_s", f"{self.nodes_s!r}, expected nodes that start at 0")
        for i, (a, b) in enumerate(pairwise(self.nodes_s), start=1):
            require_finite(f"nodes_s[{i}]", b)
            if b <= a:
                raise FieldError(f"nodes_s[{i}]", f"{b!r}, expected more than nodes_s[{i - 1}] ({a!r})")
        if len(self.rates) != len(self.nodes_s):
            raise FieldError("rates", f"{len(self.rates)} matrices, expected one for each of {len(self.nodes_s)} nodes")
        for k, matrix in enumerate(self.rates):
            _check_generator(f"rates[{k}]", matrix, len(self.rates[0]))

    @property
    def modes(self) -> int:
        """Number of modes N."""
        return len(self.rates[0])

    @classmethod
    def clipped(cls, *, low: float, high: float, slope: float = 1.0) -> TransitionRates:
        """Return two modes with lambda_12(h) = lambda_21(h) = min(max(slope h, low), high), see (2.26).

        Args:
            low: smallest rate in 1/s, at least 0.
            high: largest rate in 1/s, above low.
            slope: growth of the rate in 1/s^2.

        >>> TransitionRates.clipped(low=0.1, high=4.6).nodes_s
        (0.0, 0.1, 4.6)
        """
        nodes = [(0.0, low), (low / slope, low), (high / slope, high)]
        if low == 0.0:
            del nodes[0]
        return cls(nodes_s=tuple(h for h, _ in nodes), rates=tuple(((-r, r), (r, -r)) for _, r in nodes))

    def at(self, mode: int, h: float) -> tuple[float, ...]:
        """Return the rates in 1/s out of a mode (counted from 1) after h seconds in it; 0 to itself."""
        k = bisect_right(self.nodes_s, h) - 1
        row = self.rates[k][mode - 1]
        if k + 1 < len(self.nodes_s):
            share = (h - self.nodes_s[k]) / (self.nodes_s[k + 1] - self.nodes_s[k])
            row = tuple(a + share * (b - a) for a, b in zip(row, self.rates[k + 1][mode - 1]))
        return tuple(0.0 if j == mode - 1 else rate for j, rate in enumerate(row))


def _check_generator(path: str, matrix: Sequence[Sequence[float]], modes: int) -> None:
    if len(matrix) != modes or not matrix:
        raise FieldError(path, f"{len(matrix)} rows, expected {max(modes, 1)}")
    for i, row in enumerate(matrix):
        if len(row) != modes:
            raise FieldError(f"{path}[{i}]", f"{len(row)} entries, expected {modes}")
        for j, rate in enumerate(row):
            if i == j:
                require_finite(f"{path}[{i}][{j}]", rate)
            else:
                require_not_negative(f"{path}[{i}][{j}]", rate)
                if rate > MOST_RATE:
                    raise FieldError(f"{path}[{i}][{j}]", f"{rate!r} 1/s, expected at most {MOST_RATE:g} 1/s")
        total = math.fsum(row)
        if abs(total) > 1e-9 * max(1.0, abs(row[i])):
            raise FieldError(f"{path}[{i}]", f"row sums to {total:.6g}, expected 0")


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
        mode: mode at the start, counted from 1.
        rng: all randomness.
        now_ns: instant of the start; the sojourn clock is 0 there.
    """

    __slots__ = ("_hazards", "_rates", "_rng", "_target", "mode", "next_ns", "since_ns")

    def __init__(self, rates: TransitionRates, mode: int, rng: np.random.Generator, now_ns: int = 0) -> None:
        self._rng = rng
        self.mode = mode
        self.since_ns = now_ns
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


def check_mode(path: str, mode: int, modes: int) -> None:
    """Refuse a mode that is not one of 1 to N."""
    if not 1 <= mode <= modes:
        raise FieldError(path, f"{mode!r}, expected a mode from 1 to {modes}")


def check_clip(low: float, high: float, slope: float) -> None:
    """Refuse parameters of `TransitionRates.clipped` that describe no rate."""
    require_not_negative("rate_low", low)
    require_positive("rate_slope", slope)
    if not (math.isfinite(high) and high > low):
        raise FieldError("rate_high", f"{high!r}, expected a finite number above rate_low ({low!r})")
