"""The axis y'' + p y' = g u under held inputs, exact at the samples, with its derivatives.

    y = y_0 + v_0 phi_v(t; p) + g phi_u(t; p),     phi_v = (1 - exp(-p t))/p

It is linear in g, y_0 and v_0, so that p is the only parameter to be searched for. For the device of (6.1) g = 1/m and p = b/m;
for the motor of Section 7.4.2 they are gain and pole.

Reference: thesis (6.1), (6.2), sec. 6.2.1; variable projection: Golub and Pereyra, 1973.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

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
    poles = [1.0, -step.a]
    V = lfilter([0.0, 1.0], poles, u)  # speed over s1
    dV = lfilter([0.0, 1.0], poles, V)  # its derivative by a
    speed, slope = step.s1 * V, step.ds1 * V + step.s1 * step.da * dV
    moved = step.s1 * speed + step.s2 * u
    grown = step.ds1 * speed + step.s1 * slope + step.ds2 * u
    return _summed(moved), _summed(grown)


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
    return _summed(step.s1 * decay), _summed(step.ds1 * decay + step.s1 * slope)


def _summed(steps: Array) -> Array:
    return np.concatenate(([0.0], np.cumsum(steps)[:-1]))
