"""From logs: the axis y'' + p y' = g u of device and motor, its fit, intervals, residual test; rates of faults and detection.

Here is the axis under held inputs: its motion, exact at the samples, its records, and what they show of it.

    y = y_0 + v_0 phi_v(t; p) + g phi_u(t; p),     phi_v = (1 - exp(-p t))/p

It is linear in g, y_0 and v_0, so that p is the only parameter to be searched for. For the device of (6.1) g = 1/m and p = b/m;
for the motor of Section 7.4.2 they are gain and pole.

Reference: thesis (6.1), (6.2), sec. 6.2.1; variable projection: Golub and Pereyra, 1973.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.blas import dtbsv

from design.errors import DesignError

Array = npt.NDArray[np.float64]

SERIES_BELOW = 0.5


class Held(NamedTuple):
    """One sample of the axis: v(k+1) = a v(k) + g s1 u(k), y(k+1) = y(k) + s1 v(k) + g s2 u(k); and the derivatives by p."""

    a: float
    s1: float
    s2: float
    da: float
    ds1: float
    ds2: float


def held(pole: float, period_s: float) -> Held:
    """Return the exact zero-order hold of 1/(s (s + p)).

    Args:
        pole: p in 1/s, of any sign; 0 is the double integrator.
        period_s: T in s.

    >>> [round(x, 12) for x in held(0.0, 0.1)[:3]]
    [1.0, 0.1, 0.005]
    """
    z, T = pole * period_s, period_s
    a = float(np.exp(-z))
    if abs(z) < SERIES_BELOW:
        f1, d1 = _series(z, 1)
        f2, d2 = _series(z, 2)
    else:
        f1 = -float(np.expm1(-z)) / z
        f2 = (1.0 - f1) / z
        d1 = (a - f1) / z
        d2 = (-d1 - f2) / z
    return Held(a, T * f1, T * T * f2, -T * a, T * T * d1, T**3 * d2)


def _series(z: float, order: int) -> tuple[float, float]:
    """Return sum (-z)^k/(k + order)! and its derivative: no difference of nearly equal numbers."""
    value = slope = 0.0
    term = 1.0 / (1.0 if order == 1 else 2.0)  # (-z)^k/(k + order)!
    power = 1.0  # (-z)^(k - 1)/(k + order)!
    for k in range(18):
        value += term
        power = term
        term *= -z / (k + order + 1)
        slope -= (k + 1) * power / (k + order + 1)
    return value, slope


def forced(u: Array, pole: float, period_s: float) -> tuple[Array, Array]:
    """Return phi_u at the samples (n,), and its derivative by p (n,): the response from rest for g = 1.

    Args:
        u: input (n,), held over a sample.
        pole: p in 1/s.
        period_s: T in s.
    """
    step = held(pole, period_s)
    V = recursion((-step.a,), u)  # speed over s1
    dV = recursion((-step.a,), V)  # its derivative by a
    speed, slope = step.s1 * V, step.ds1 * V + step.s1 * step.da * dV
    moved = step.s1 * speed + step.s2 * u
    grown = step.ds1 * speed + step.s1 * slope + step.ds2 * u
    return recursion((-1.0,), moved), recursion((-1.0,), grown)


def free(count: int, pole: float, period_s: float) -> tuple[Array, Array]:
    """Return phi_v at the samples (n,), and its derivative by p (n,): how far a speed of 1 carries.

    Args:
        count: n.
        pole: p in 1/s.
        period_s: T in s.
    """
    step = held(pole, period_s)
    k = np.arange(count)
    decay = np.exp(-pole * period_s * k)
    slope = -period_s * k * decay
    return recursion((-1.0,), step.s1 * decay), recursion((-1.0,), step.ds1 * decay + step.s1 * slope)


def recursion(feedback: Sequence[float], x: Array) -> Array:
    """Return v(k) = x(k-1) - a_1 v(k-1) - a_2 v(k-2) - ..., from rest: the solution of a band of equations, (n,).

    Args:
        feedback: a_1, a_2, ...
        x: what is filtered (n,).

    >>> recursion((-0.5,), np.array([1.0, 0.0, 0.0])).tolist()
    [0.0, 1.0, 0.5]
    """
    band = np.broadcast_to(np.array([[1.0], *([a] for a in feedback)]), (1 + len(feedback), x.size))
    # scipy.signal takes half a second of imports
    return np.asarray(dtbsv(len(feedback), band, np.concatenate(([0.0], x[:-1])), lower=1, diag=1))


LEAST_SAMPLES = 20
LARGEST = 1e30
"""Of what a record holds; a fit computes squares of it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """One recorded experiment on an axis: input and output over consecutive slots.

    Args:
        u: input (n,), u[k] held over [k T, (k + 1) T), in the input's unit.
        y: output (n,) at k T, in the output's unit; NaN where a sample is missing.
        period_s: T in s.

    Raises:
        DesignError: the lengths differ, there are too few samples, an input is missing, or numbers leave what a fit computes.
    """

    u: Array
    y: Array
    period_s: float

    def __post_init__(self) -> None:
        u, y = np.array(self.u, dtype=np.float64), np.array(self.y, dtype=np.float64)
        if not 1.0 / LARGEST <= self.period_s <= LARGEST:
            raise DesignError(f"period_s: {self.period_s!r}, expected a number above 0, {1.0 / LARGEST:g} to {LARGEST:g}")
        if u.ndim != 1 or u.shape != y.shape:
            raise DesignError(f"record: inputs of shape {u.shape} and outputs of shape {y.shape}, expected two equal lengths")
        if not np.isfinite(u).all():
            raise DesignError(f"record: input {int(np.flatnonzero(~np.isfinite(u))[0])} is missing; a fit needs every input")
        for name, values in (("input", u), ("output", y)):
            size = float(np.max(np.abs(values), where=~np.isnan(values), initial=0.0))
            if size and not 1.0 / LARGEST <= size <= LARGEST:
                raise DesignError(f"record: the largest {name} is {size:g}, expected {1.0 / LARGEST:g} to {LARGEST:g}")
        if int(np.isfinite(y).sum()) < LEAST_SAMPLES:
            raise DesignError(f"record: {int(np.isfinite(y).sum())} outputs, expected at least {LEAST_SAMPLES}")
        object.__setattr__(self, "u", u)
        object.__setattr__(self, "y", y)

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """Which outputs are there (n,)."""
        return np.isfinite(self.y)


WORST_CONDITION = 1e7
"""Condition number of the scaled sensitivities above which a record cannot tell the parameters apart."""


def square_wave(slots: int, period_s: float, frequency_hz: float, amplitude: float) -> Array:
    """Return a square wave r (slots,) that begins with +amplitude.

    It moves an axis so that its parameters can be estimated.

    Args:
        slots: how many samples.
        period_s: T in s.
        frequency_hz: of the wave; half a wave is rounded to whole samples.
        amplitude: in the output's unit.

    Raises:
        DesignError: half a wave is shorter than a sample.

    Reference: sec. 6.2.1: 0.4545 Hz, 0.02.
    """
    half = round(0.5 / (frequency_hz * period_s))
    if half < 1:
        raise DesignError(f"frequency_hz: {frequency_hz:g} Hz, expected at most {0.5 / period_s:g} Hz at T = {period_s:g} s")
    return np.where((np.arange(slots) // half) % 2 == 0, amplitude, -amplitude).astype(np.float64)


def sensitivities(records: Sequence[Record], gain: float, pole: float, starts: Sequence[tuple[float, float]]) -> Array:
    """Return the derivatives of all measured outputs by (g, p, y_0 and v_0 of every record), (samples, 2 + 2 records).

    Args:
        records: what was recorded.
        gain, pole: g and p.
        starts: y_0 and v_0 of every record.
    """
    blocks = []
    for i, (record, (_, speed)) in enumerate(zip(records, starts)):
        kept = record.measured
        by_gain, forced_slope = forced(record.u, pole, record.period_s)
        by_speed, free_slope = free(record.u.size, pole, record.period_s)
        block = np.zeros((int(kept.sum()), 2 + 2 * len(records)))
        block[:, 0] = by_gain[kept]
        block[:, 1] = (gain * forced_slope + speed * free_slope)[kept]
        block[:, 2 + 2 * i] = 1.0
        block[:, 3 + 2 * i] = by_speed[kept]
        blocks.append(block)
    return np.vstack(blocks)


def covariance(jacobian: Array) -> Array:
    """Return (J' J)^-1: the covariance of the parameters for independent noise of sd 1.

    Args:
        jacobian: J (samples, parameters).

    Raises:
        DesignError: the record cannot tell the parameters apart; the message has the condition number that decides it.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    if not (np.isfinite(scale).all() and scale.min() > 0.0):
        raise DesignError("excitation: the input does not move the axis; the record determines neither gain nor pole")
    r = np.linalg.qr(jacobian / scale, mode="r")
    values = np.linalg.svd(r, compute_uv=False)
    condition = math.inf if values[-1] == 0.0 else float(values[0] / values[-1])
    if not condition < WORST_CONDITION:
        raise DesignError(
            f"excitation: the record does not separate gain from pole (condition number {condition:.3g}, expected below "
            f"{WORST_CONDITION:g}); move the axis at other frequencies too, a square wave for instance"
        )
    inverse = np.linalg.inv(r)
    return np.asarray(inverse @ inverse.T / np.outer(scale, scale))


def expected_errors(u: npt.ArrayLike, period_s: float, gain: float, pole: float, noise_sd: float) -> tuple[float, float]:
    """Return the standard errors of g and p that a record of this input, from rest, will give (Cramer-Rao).

    Args:
        u: input (n,).
        period_s: T in s.
        gain, pole: g and p as expected.
        noise_sd: standard deviation of the measured output.
    """
    inputs = np.asarray(u, dtype=np.float64)
    record = Record(u=inputs, y=np.zeros(inputs.size), period_s=period_s)
    sd = noise_sd * np.sqrt(np.diag(covariance(sensitivities([record], gain, pole, [(0.0, 0.0)]))))
    return float(sd[0]), float(sd[1])


ALIKE = 1e-6
"""Share of the term, behind the sensitivities, below which it is one of them."""


def dry_friction(
    records: Sequence[Record], gain: float, pole: float, starts: Sequence[tuple[float, float]], left: Array, jacobian: Array
) -> tuple[float, float]:  # fmt: skip
    """Return the dry friction f and its standard error, in the input's unit; 0 and infinity where no record can show it.

    Residuals do not show it, for damping takes its place: a square wave against 2 % of its force leaves white residuals in 98 of
    100 fits, and an interval of p that misses in all of them. So one more term is fitted to what is left, the response to
    -f sign(v) of the fitted speed v, beside all the sensitivities. What it cannot tell from damping it says by its interval.

    Reference: thesis (7.39); a score test: C. R. Rao, Proc. Cambridge Phil. Soc. 44 (1948) 50-57.

    Args:
        records: what was recorded.
        gain, pole, starts: of the fit.
        left: its residuals (n,).
        jacobian: its sensitivities (n, parameters).
    """
    signs = [np.sign(_speed(record, gain, pole, speed)) for record, (_, speed) in zip(records, starts)]
    moved = [forced(sign, pole, record.period_s)[0][record.measured] for record, sign in zip(records, signs)]
    term = -gain * np.concatenate(moved)
    base = np.linalg.qr(jacobian / np.linalg.norm(jacobian, axis=0))[0]
    alone = term - base @ (base.T @ term)
    square, freedom = float(alone @ alone), left.size - jacobian.shape[1] - 1
    if square <= (ALIKE**2) * float(term @ term):
        return 0.0, math.inf
    found = float(alone @ left) / square
    rest = left - found * alone
    return found, math.sqrt(float(rest @ rest) / freedom / square)


def _speed(record: Record, gain: float, pole: float, begin: float) -> Array:
    """Return v(k) (n,): v(k+1) = a v(k) + g s1 u(k)."""
    step = held(pole, record.period_s)
    return begin * step.a ** np.arange(record.u.size) + recursion((-step.a,), gain * step.s1 * record.u)
