"""A transition rate that a user's function gives, with the bounds it promises; see `design.processes.rates`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from design.errors import FieldError
from design.processes.rates import FloatArray, check_positive

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
        check_positive("lower", self.lower, zero=True)
        check_positive("horizon_s", self.horizon_s)
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
