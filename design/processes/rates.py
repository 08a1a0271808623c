"""Transition rates lambda(h) of semi-Markov processes: how likely the next jump is, h seconds after the last one.

Every rate is a frozen callable of the sojourn time h (seconds, array) with values in 1/s, and offers

- ``integral(h)``: H(h) = int_0^h lambda(s) ds, so that exp(-H(h)) is the probability of no jump before h;
- ``bounds(start, stop)``: the infimum and supremum over [start, stop) (``stop`` may be ``inf``), at which the
  inequalities of Chapters 2 to 4 are evaluated;
- ``breaks``: the sojourn times at which lambda or its slope is not smooth; quadrature and Lyapunov nodes respect them;
- ``settled``: the sojourn time after which lambda is constant (``inf`` if it never is);
- ``limit``, if it can (``TendingRate``): where lambda tends to.

Families here: constant, clipped ramp (2.26), piecewise linear table, Weibull, a fraction of another rate.
``design.processes.further_rates`` adds a user's function with bounds, the bathtub and the redundant components of Figures 4.1
and 4.2.

References: thesis Sections 2.2 and 2.5.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from design.errors import FieldError, check_above_zero, check_at_least_zero
from design.processes import elementary

FloatArray = npt.NDArray[np.float64]


@runtime_checkable
class Rate(Protocol):
    """What a transition rate must offer; see the module's docstring. Who derives from it is smooth and monotone, or says more."""

    @property
    def breaks(self) -> tuple[float, ...]:
        return ()

    @property
    def settled(self) -> float: ...

    def __call__(self, h: npt.ArrayLike) -> FloatArray: ...

    def integral(self, h: npt.ArrayLike) -> FloatArray: ...

    def bounds(self, start: float, stop: float) -> tuple[float, float]:
        low, high = sorted((float(self(start)), float(self(stop))))
        return low, high


@runtime_checkable
class TendingRate(Protocol):
    """A rate that knows where it tends to; without it nothing is proved about sojourns that last for ever."""

    @property
    def limit(self) -> float:
        """lim lambda(h) for h to infinity (1/s): 0, a number or ``inf``; nan where it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PiecewiseLinearRate:
    """Rate interpolated linearly between nodes and constant after the last one.

    A node may be repeated to make a step; the rate is then continuous from the right.

    Args:
        times_s: node positions, first one 0, not decreasing (s), shape (R,).
        values: rate at the nodes (1/s), shape (R,).

    >>> ramp = PiecewiseLinearRate(times_s=(0.0, 1.0, 2.0), values=(0.0, 2.0, 2.0))
    >>> ramp([0.5, 3.0]).tolist(), ramp.integral([1.0, 3.0]).tolist(), ramp.bounds(0.5, 1.5)
    ([1.0, 2.0], [1.0, 5.0], (1.0, 2.0))
    """

    times_s: tuple[float, ...]
    values: tuple[float, ...]
    _start: FloatArray = field(init=False, repr=False, compare=False)
    _value: FloatArray = field(init=False, repr=False, compare=False)
    _slope: FloatArray = field(init=False, repr=False, compare=False)
    _total: FloatArray = field(init=False, repr=False, compare=False)
    _begins: tuple[float, ...] = field(init=False, repr=False, compare=False)
    # begin, value, slope, end
    _cells: tuple[tuple[float, float, float, float], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        times, values = np.asarray(self.times_s, dtype=float), np.asarray(self.values, dtype=float)
        if times.ndim != 1 or times.size == 0:
            raise FieldError("times_s", "expected at least one node")
        if values.shape != times.shape:
            raise FieldError("values", f"{values.size} values for {times.size} nodes")
        if not np.isfinite(times).all() or times[0] != 0.0 or (np.diff(times) < 0).any():
            raise FieldError("times_s", f"expected finite nodes 0 = t_0 <= t_1 <= ..., got {self.times_s}")
        check_at_least_zero(**{f"values[{index}]": value for index, value in enumerate(values.tolist())})
        width = np.append(np.diff(times), np.inf)
        keep = width > 0
        rise = np.append(np.diff(values), 0.0)
        slope = np.divide(rise, width, out=np.zeros_like(width), where=np.isfinite(width) & keep)[keep]
        start, value, width = times[keep], values[keep], width[keep]
        area = (value[:-1] + 0.5 * slope[:-1] * width[:-1]) * width[:-1]
        object.__setattr__(self, "times_s", tuple(times.tolist()))
        object.__setattr__(self, "values", tuple(values.tolist()))
        object.__setattr__(self, "_start", start)
        object.__setattr__(self, "_value", value)
        object.__setattr__(self, "_slope", slope)
        object.__setattr__(self, "_total", np.concatenate([[0.0], np.cumsum(area)]))
        begins = tuple(start.tolist())
        object.__setattr__(self, "_begins", begins)
        object.__setattr__(self, "_cells", tuple(zip(begins, value.tolist(), slope.tolist(), (*begins[1:], math.inf))))

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(self._start[1:].tolist())

    @property
    def settled(self) -> float:
        return float(self._start[-1])

    @property
    def limit(self) -> float:
        return self.values[-1]

    def _cell(self, h: FloatArray) -> npt.NDArray[np.intp]:
        return np.maximum(np.searchsorted(self._start, h, side="right") - 1, 0)

    def __call__(self, h: npt.ArrayLike) -> FloatArray:
        h = np.asarray(h, dtype=float)
        cell = self._cell(h)
        with np.errstate(invalid="ignore"):  # h = inf in the last, constant cell
            rise = self._slope[cell] * (h - self._start[cell])
        return self._value[cell] + np.where(np.isnan(rise), 0.0, rise)

    def integral(self, h: npt.ArrayLike) -> FloatArray:
        h = np.asarray(h, dtype=float)
        cell = self._cell(h)
        into = h - self._start[cell]
        with np.errstate(invalid="ignore"):  # h = inf in the last, constant cell
            flat, bent = self._value[cell] * into, 0.5 * self._slope[cell] * into * into
        return self._total[cell] + np.where(np.isnan(flat), 0.0, flat) + np.where(np.isnan(bent), 0.0, bent)

    def inverse_integral(self, target: npt.ArrayLike) -> FloatArray:
        """h with H(h) = target in closed form; ``inf`` where the rate never accumulates that much.

        In a cell, with v the rate at its start, s its slope and e the area still missing:
        v x + s x^2 / 2 = e, whose wanted root in its numerically stable form is x = 2 e / (v + sqrt(v^2 + 2 s e)).
        """
        target = np.asarray(target, dtype=float)
        cell = np.maximum(np.searchsorted(self._total, target, side="left") - 1, 0)
        missing = target - self._total[cell]
        value = self._value[cell]
        root = value + np.sqrt(np.maximum(value * value + 2.0 * self._slope[cell] * missing, 0.0))
        step = np.divide(2.0 * missing, root, out=np.full_like(missing, np.inf), where=root > 0.0)
        return self._start[cell] + np.where(missing <= 0.0, 0.0, step)

    def bounds(self, start: float, stop: float) -> tuple[float, float]:
        # Ends of every cell that meets [start, stop), each seen from inside its cell (steps).
        first = max(bisect_right(self._begins, start) - 1, 0)
        behind = max(bisect_left(self._begins, stop), first + 1)
        low, high = math.inf, -math.inf
        for begin, value, slope, after in self._cells[first:behind]:
            ends = [max(begin, start)]
            if slope != 0.0:
                ends.append(min(after, stop))
            seen = [value + slope * (end - begin) for end in ends]
            low, high = min(low, *seen), max(high, *seen)
        return low, high


def constant_rate(value: float) -> PiecewiseLinearRate:
    """The memoryless rate of a Markov jump system: lambda(h) = value (1/s)."""
    return PiecewiseLinearRate(times_s=(0.0,), values=(value,))


def clip_rate(lower: float, upper: float, slope: float = 1.0) -> PiecewiseLinearRate:
    """The clipped ramp (2.26): lambda(h) = min(max(slope h, lower), upper).

    >>> clip_rate(0.1, 4.6)([0.0, 1.0, 9.0]).tolist()
    [0.1, 1.0, 4.6]
    """
    check_at_least_zero(lower=lower)
    check_above_zero(slope=slope)
    if not math.isfinite(upper) or upper <= lower:
        raise FieldError("upper", f"{upper!r} is not above lower = {lower!r}: the rate crosses its bounds")
    first = 1 if lower == 0.0 else 0
    return PiecewiseLinearRate(times_s=(0.0, lower / slope, upper / slope)[first:], values=(lower, lower, upper)[first:])


@dataclass(frozen=True, slots=True, kw_only=True)
class WeibullRate(Rate):
    """Weibull hazard lambda(h) = (shape/scale) (h/scale)^(shape-1), H(h) = (h/scale)^shape.

    Scale 1 and shape 2 give 2h, not h as the text above (2.26) says.

    >>> WeibullRate(scale_s=1.0, shape=2.0)(3.0).item()
    6.0
    """

    scale_s: float
    shape: float

    def __post_init__(self) -> None:
        check_above_zero(scale_s=self.scale_s, shape=self.shape)

    @property
    def settled(self) -> float:
        return 0.0 if self.shape == 1.0 else math.inf

    @property
    def limit(self) -> float:
        return 1.0 / self.scale_s if self.shape == 1.0 else 0.0 if self.shape < 1.0 else math.inf

    def __call__(self, h: npt.ArrayLike) -> FloatArray:
        with np.errstate(divide="ignore"):
            power = elementary.power(np.asarray(h, dtype=float) / self.scale_s, self.shape - 1.0)
        return np.asarray(self.shape / self.scale_s * power)

    def integral(self, h: npt.ArrayLike) -> FloatArray:
        return elementary.power(np.asarray(h, dtype=float) / self.scale_s, self.shape)

@dataclass(frozen=True, slots=True, kw_only=True)
class ScaledRate:
    """A fraction of another rate: lambda_ij(h) = q_ij lambda_i(h), the form (2.7) with a constant q_ij."""

    rate: Rate
    factor: float

    def __post_init__(self) -> None:
        check_above_zero(factor=self.factor)

    @property
    def breaks(self) -> tuple[float, ...]:
        return self.rate.breaks

    @property
    def settled(self) -> float:
        return self.rate.settled

    @property
    def limit(self) -> float:
        return self.factor * self.rate.limit if isinstance(self.rate, TendingRate) else math.nan

    def __call__(self, h: npt.ArrayLike) -> FloatArray:
        return self.factor * self.rate(h)

    def integral(self, h: npt.ArrayLike) -> FloatArray:
        return self.factor * self.rate.integral(h)

    def bounds(self, start: float, stop: float) -> tuple[float, float]:
        low, high = self.rate.bounds(start, stop)
        return self.factor * low, self.factor * high
