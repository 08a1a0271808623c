"""What a plant that jumps states: the rates of its modes, which depend on the time since the last jump, and their matrices."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, TypeVar

from plants.errors import SHORTEST_STEP_S, FieldError, require_finite, require_not_negative, require_positive
from plants.parts.exponential import Rows

Generator = tuple[tuple[float, ...], ...]
T = TypeVar("T")

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


@dataclass(frozen=True, slots=True, kw_only=True)
class JumpModel:
    """The matrices of a plant with N modes, mode by mode: what runs, with the parameters that the plant was given.

    x' = (A_i + dA_i) x + Ad_i x(t - tau_i(t)) + (B_i + dB_i) u + E_i w,  z = C_i x; the measurement is S_i x and the mode seen.

    Args:
        A: N matrices, n x n.
        B: N matrices, n x m.
        C: N matrices, p x n, of the performance output z; empty: none.
        E: N matrices, n x q, of the disturbance w; empty: none.
        Ad: N matrices, n x n, of the delayed state; empty: no delay inside.
        max_delay_s: largest tau_i in s.
        min_delay_s: smallest tau_i in s; 0: the plant may be without a delay, and is refused where its loop then is unstable.
        delay_slopes: N bounds of the growth of tau_i, in s per s.
        changes: V pairs (dA of every mode, dB of every mode); what is uncertain lies in their convex hull at every instant.
            Empty: nothing is uncertain.
        S: N matrices, n x n, of the sensors; empty: every sensor shows its state in every mode. The first n entries of the
            running plant's ``state`` then are x.

    Reference: thesis (2.16), (3.1), (4.1), Remark 4.1.
    """

    A: tuple[Rows, ...]
    B: tuple[Rows, ...]
    C: tuple[Rows, ...] = ()
    E: tuple[Rows, ...] = ()
    Ad: tuple[Rows, ...] = ()
    max_delay_s: float = 0.0
    min_delay_s: float = 0.0
    delay_slopes: tuple[float, ...] = ()
    changes: tuple[tuple[tuple[Rows, ...], tuple[Rows, ...]], ...] = ()
    S: tuple[Rows, ...] = ()

    def of_modes(self, modes: Sequence[int]) -> JumpModel:
        """Return the matrices of some of its modes.

        Args:
            modes: counted from 0, in order.
        """
        return replace(
            self, A=_of(self.A, modes), B=_of(self.B, modes), C=_of(self.C, modes), E=_of(self.E, modes), Ad=_of(self.Ad, modes),
            delay_slopes=_of(self.delay_slopes, modes), S=_of(self.S, modes),
            changes=tuple((_of(dA, modes), _of(dB, modes)) for dA, dB in self.changes),
        )  # fmt: skip


def _of(each: tuple[T, ...], modes: Sequence[int]) -> tuple[T, ...]:
    return tuple(each[mode] for mode in modes) if each else ()


@dataclass(frozen=True, slots=True, kw_only=True)
class JumpRates:
    """How the modes change, and what the measurement shows of them.

    Args:
        rates: transition rates of the true mode.
        detection: for every true mode the rates of the detected mode, which alone is measured; empty: the true mode is measured.
        failure_restarts_detection_clock: whether a jump of the true mode restarts the sojourn clock of the detected one.
        initial: true modes in which a run may begin, from 1; empty: any. What no run comes to is no part of a certificate.
        initial_detected: detected modes in which a run may begin, from 1; empty: any.

    Raises:
        ValueError: a run begins in a mode that there is not.

    Reference: thesis (2.1), sec. 4.2.
    """

    rates: TransitionRates
    detection: tuple[TransitionRates, ...] = ()
    failure_restarts_detection_clock: bool = False
    initial: tuple[int, ...] = ()
    initial_detected: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        detected = self.detection[0].modes if self.detection else 0
        begins = (("initial", self.initial, self.rates.modes), ("initial_detected", self.initial_detected, detected))
        for field, first, modes in begins:
            for mode in first:
                check_mode(field, mode, modes)

    def reached(self) -> tuple[list[int], list[int]]:
        """Return the true and the detected modes that a run may come to, counted from 0; of the latter none where all is seen."""
        true = _reached([self.rates], self.initial)
        return true, _reached([self.detection[mode] for mode in true], self.initial_detected) if self.detection else []

    def of_modes(self, true: Sequence[int], detected: Sequence[int]) -> JumpRates:
        """Return the rates between some of its modes, which none of them leaves for another.

        Args:
            true, detected: modes, counted from 0, in order.
        """
        detection = tuple(_between(self.detection[mode], detected) for mode in true) if self.detection else ()
        return replace(self, rates=_between(self.rates, true), detection=detection, initial=(), initial_detected=())


def _between(table: TransitionRates, modes: Sequence[int]) -> TransitionRates:
    if len(modes) == table.modes:
        return table
    return replace(table, rates=tuple(tuple(_of(matrix[mode], modes) for mode in modes) for matrix in table.rates))


def _reached(tables: Sequence[TransitionRates], first: Sequence[int]) -> list[int]:
    """The modes, from 0, that some tables of rates lead to; all of them where any may be the first."""
    ahead = [mode - 1 for mode in first] or list(range(tables[0].modes))
    found = set(ahead)
    while ahead:
        row = ahead.pop()
        after = {j for table in tables for matrix in table.rates for j, rate in enumerate(matrix[row]) if rate > 0.0} - found
        found |= after
        ahead += after
    return sorted(found)
