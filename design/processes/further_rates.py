"""Rates of redundant and ageing components, from which Chapter 4 starts (Figures 4.1, 4.2), and of a user's function.

A component with a constant failure rate c has an exponential lifetime; a system of several such components has not.
Every class here is a ``design.processes.rates.Rate``; e^(-integral) is the probability that the system still works, and the
density of Figure 4.1 is this times the rate.

Reference: thesis Section 4.1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from design.errors import FieldError, check_above_zero, check_at_least_zero
from design.processes import elementary
from design.processes.rates import FloatArray, Rate


@dataclass(frozen=True, slots=True, kw_only=True)
class BathtubRate(Rate):
    """Infant mortality, useful life, wear: infant e^(-h/infant_time_s) + useful + wear clip(h - start, 0, span).

    Args:
        infant, useful: rates (1/s); infant_time_s: time constant of the infant part (s).
        wear: slope (1/s^2) of the wear part, which starts at wear_start_s and has saturated wear_span_s later.
    """

    infant: float
    infant_time_s: float
    useful: float
    wear: float
    wear_start_s: float
    wear_span_s: float

    def __post_init__(self) -> None:
        check_at_least_zero(infant=self.infant, useful=self.useful, wear=self.wear, wear_start_s=self.wear_start_s)
        check_above_zero(infant_time_s=self.infant_time_s, wear_span_s=self.wear_span_s)

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted({self.wear_start_s, self.wear_start_s + self.wear_span_s} - {0.0}))

    @property
    def settled(self) -> float:
        return math.inf

    @property
    def limit(self) -> float:
        return self.useful + self.wear * self.wear_span_s

    def __call__(self, h: npt.ArrayLike) -> FloatArray:
        h = np.asarray(h, dtype=float)
        worn = np.clip(h - self.wear_start_s, 0.0, self.wear_span_s)
        return np.asarray(self.infant * elementary.exp(-h / self.infant_time_s) + self.useful + self.wear * worn)

    def integral(self, h: npt.ArrayLike) -> FloatArray:
        h = np.asarray(h, dtype=float)
        worn = np.clip(h - self.wear_start_s, 0.0, self.wear_span_s)
        after = np.maximum(h - self.wear_start_s - self.wear_span_s, 0.0)
        infant = -self.infant * self.infant_time_s * elementary.expm1(-h / self.infant_time_s)
        wear = self.wear * (0.5 * worn * worn + self.wear_span_s * after)
        return np.asarray(infant + self.useful * h + wear)

    def bounds(self, start: float, stop: float) -> tuple[float, float]:
        points = [start, stop, *(b for b in self.breaks if start < b < stop)]
        if self.infant > 0 and self.wear > 0:  # the slope vanishes where infant/infant_time e^(-h/infant_time) = wear
            valley = self.infant_time_s * float(elementary.log(self.infant / (self.infant_time_s * self.wear)))
            if max(start, self.wear_start_s) < valley < min(stop, self.wear_start_s + self.wear_span_s):
                points.append(valley)
        values = self(points)
        return float(values.min()), float(values.max())


@dataclass(frozen=True, slots=True, kw_only=True)
class KOutOfNRate(Rate):
    """Hazard of n active components of which k must work, each failing at a constant rate (Figures 4.1, 4.2).

    With p = e^(-rate h): R = sum_{j>=k} C(n,j) p^j (1-p)^(n-j), f = k C(n,k) rate p^k (1-p)^(n-k), lambda = f/R, which
    grows from 0 (n > k) to k rate.
    """

    needed: int
    installed: int
    rate: float

    def __post_init__(self) -> None:
        check_above_zero(rate=self.rate)
        if not 1 <= self.needed <= self.installed:
            raise FieldError("needed", f"{self.needed} of {self.installed} components is not between 1 and all")

    @property
    def settled(self) -> float:
        return 0.0 if self.needed == self.installed else math.inf

    @property
    def limit(self) -> float:
        return self.needed * self.rate

    def _ratio(self, p: FloatArray) -> FloatArray:
        # R / p^k, so that numerator and denominator of the hazard keep their digits when p underflows.
        k, n = self.needed, self.installed
        power = elementary.power
        return np.asarray(sum(math.comb(n, j) * power(p, j - k) * power(1 - p, n - j) for j in range(k, n + 1)))

    def __call__(self, h: npt.ArrayLike) -> FloatArray:
        p = elementary.exp(-self.rate * np.asarray(h, dtype=float))
        ratio = self._ratio(p)
        density = self.needed * math.comb(self.installed, self.needed) * elementary.power(1 - p, self.installed - self.needed)
        return np.asarray(self.rate * density / ratio)

    def integral(self, h: npt.ArrayLike) -> FloatArray:
        h = np.asarray(h, dtype=float)
        p = elementary.exp(-self.rate * h)
        return np.asarray(self.needed * self.rate * h - elementary.log(self._ratio(p)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ColdStandbyRate(Rate):
    """Hazard of a component with n - 1 cold spares, an Erlang lifetime (Figures 4.1, 4.2).

    With a = rate h: lambda = rate (a^(n-1)/(n-1)!) / sum_{j<n} a^j/j!, which grows from 0 (n > 1) to rate.
    """

    installed: int
    rate: float

    def __post_init__(self) -> None:
        check_above_zero(rate=self.rate)
        if self.installed < 1:
            raise FieldError("installed", f"{self.installed} components, expected at least 1")

    @property
    def settled(self) -> float:
        return 0.0 if self.installed == 1 else math.inf

    @property
    def limit(self) -> float:
        return self.rate

    def _terms(self, h: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        # Each term relative to the largest power: stable for long times.
        a = self.rate * np.asarray(h, dtype=float)
        orders = np.arange(self.installed)
        factorials = np.cumsum(np.concatenate([[0.0], elementary.log(orders[1:])]))
        with np.errstate(invalid="ignore"):  # at a = 0
            log_terms = np.where(orders == 0, 0.0, orders * elementary.log(a)[..., None]) - factorials
        largest = log_terms.max(axis=-1)
        total = elementary.exp(log_terms - largest[..., None]).sum(axis=-1)
        return largest + elementary.log(total), log_terms[..., -1]

    def __call__(self, h: npt.ArrayLike) -> FloatArray:
        h = np.asarray(h, dtype=float)
        total, last = self._terms(np.where(np.isinf(h), 0.0, h))
        return np.asarray(np.where(np.isinf(h), self.rate, self.rate * elementary.exp(last - total)))

    def integral(self, h: npt.ArrayLike) -> FloatArray:
        return np.asarray(self.rate * np.asarray(h, dtype=float) - self._terms(h)[0])


_GAUSS_8: Final = (
    (-0.9602898564975363, 0.10122853629037626),
    (-0.7966664774136267, 0.22238103445337448),
    (-0.525532409916329, 0.31370664587788727),
    (-0.1834346424956498, 0.362683783378362),
    (0.1834346424956498, 0.362683783378362),
    (0.525532409916329, 0.31370664587788727),
    (0.7966664774136267, 0.22238103445337448),
    (0.9602898564975363, 0.10122853629037626),
)
"""Points and weights of Gauss and Legendre, each rounded once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UserRate:
    """A user's vectorised function of h with the bounds it promises, constant after ``horizon_s``.

    Args:
        function: lambda(h) (1/s) for an array h (s), smooth between ``breaks``.
        lower, upper: promised bounds (1/s); checked at 513 points per smooth piece, used as they are in every inequality.
        horizon_s: after it the rate keeps its value (s).

    Raises:
        ValueError: the function is not finite, negative, or crosses its bounds (with the sojourn time where it does).
    """

    function: Callable[[FloatArray], npt.ArrayLike]
    lower: float
    upper: float
    horizon_s: float
    breaks: tuple[float, ...] = ()
    _nodes: FloatArray = field(init=False, repr=False, compare=False)
    _total: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_at_least_zero(lower=self.lower)
        check_above_zero(horizon_s=self.horizon_s)
        if not math.isfinite(self.upper) or self.upper < self.lower:
            raise FieldError("upper", f"{self.upper!r} is below lower = {self.lower!r}: the bounds cross")
        inner = [b for b in sorted(self.breaks) if 0 < b < self.horizon_s]
        edges = [0.0, *inner, self.horizon_s]
        pieces = [np.linspace(a, b, 513) for a, b in pairwise(edges)]
        nodes = np.unique(np.concatenate(pieces))
        object.__setattr__(self, "_nodes", nodes)
        values = self(nodes)
        slack = 1e-12 * max(1.0, self.upper)
        wrong = ~np.isfinite(values) | (values < self.lower - slack) | (values > self.upper + slack)
        if wrong.any():
            where = int(np.argmax(wrong))
            raise FieldError(
                "function",
                f"{values[where]:.6g} at h = {nodes[where]:.6g} s is outside its bounds [{self.lower:g}, {self.upper:g}]",
            )
        cells = np.array([self._cell_integral(np.array([a]), np.array([b]))[0] for a, b in pairwise(nodes)])
        object.__setattr__(self, "_total", np.concatenate([[0.0], np.cumsum(cells)]))

    @property
    def settled(self) -> float:
        return self.horizon_s

    @property
    def limit(self) -> float:
        return float(self(self.horizon_s))

    def __call__(self, h: npt.ArrayLike) -> FloatArray:
        inside = np.minimum(np.asarray(h, dtype=float), self.horizon_s)
        return np.asarray(np.broadcast_to(np.asarray(self.function(inside), dtype=float), inside.shape))

    def _cell_integral(self, start: FloatArray, stop: FloatArray) -> FloatArray:
        half = 0.5 * (stop - start)
        total = np.zeros(np.shape(half))
        for point, weight in _GAUSS_8:  # in this order: the sum does not depend on how many are computed at once
            total += weight * self(start + half + half * point)
        return np.asarray(half * total)

    def integral(self, h: npt.ArrayLike) -> FloatArray:
        h = np.asarray(h, dtype=float)
        inside = np.minimum(h, self.horizon_s)
        cell = np.clip(np.searchsorted(self._nodes, inside, side="right") - 1, 0, self._nodes.size - 2)
        head = self._total[cell] + self._cell_integral(self._nodes[cell], inside)
        return np.asarray(head + np.maximum(h - self.horizon_s, 0.0) * float(self(self.horizon_s)))

    def bounds(self, start: float, stop: float) -> tuple[float, float]:
        if start >= self.horizon_s:
            last = float(self(self.horizon_s))
            return last, last
        return self.lower, self.upper
