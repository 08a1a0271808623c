"""Confidence intervals by profile likelihood: what a parameter may be, whatever the others are.

    D(v) = 2 (max l - max over the others of l(v, others)) <= c,

and c is the quantile of chi-square with one degree of freedom where v is far from an end of [0, 1]. Near one, which no estimate
passes, D is smaller: of v at delta standard errors from the end it is Z^2 where Z > -delta, else -2 Z delta - delta^2, with Z
standard normal. So c falls from 3.84 at delta = 1.96 to 2.71 at the end, the quantile of the mixture of chi-squares with 0 and 1
degrees of freedom (Chernoff 1954; Self and Liang 1987; intervals so found: Feldman and Cousins 1998). The standard error is that
of the parabola through D at the end, at the interval's other bound, and half way.

A parameter is sin^2 of its angle: an end is an angle like every other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy import optimize, special

from transport.law_fit.packet_record import Array
from transport.law_fit.proportions import LEVEL, Interval

Cost = Callable[[Array], Array]
"""Minus the log-likelihood, (b, m) angles to (b,)."""

RIGHT = math.pi / 2.0
STEP = 1e-3
APART = 0.02
"""Angle from an end at which a search begins: at the end itself the slope is 0."""
CLOSE = 0.005
"""Error of a bound, in standard errors."""
FAR = float(special.ndtri(0.5 + LEVEL / 2.0))


def values_of(angles: Array) -> Array:
    """Return parameters, sin^2."""
    return np.asarray(np.sin(angles) ** 2, dtype=np.float64)


def angles_of(values: Array) -> Array:
    """Return angles in [0, pi/2]."""
    return np.arcsin(np.sqrt(np.clip(values, 0.0, 1.0)))


@lru_cache(maxsize=256)
def critical(delta: float) -> float:
    """Return the square root of c, `delta` standard errors from an end.

    >>> [round(critical(d) ** 2, 2) for d in (0.0, 1.0, 1.9, 5.0)]
    [2.71, 3.31, 3.84, 3.84]
    """
    if delta >= FAR:
        return FAR
    if delta <= 1e-6:
        return float(special.ndtri(LEVEL))

    def surplus(root: float) -> float:
        return float(special.ndtr(root) - special.ndtr(-(root * root + delta * delta) / (2.0 * delta))) - LEVEL

    return float(optimize.brentq(surplus, 1.0, 3.0, xtol=1e-6))


def minimum(cost: Cost, begin: Array, inverse: Array | None = None) -> tuple[Array, float]:
    """Return the angles (m,) of the least cost near `begin`, and the cost there.

    Args:
        cost: see `Cost`.
        begin: (m,) angles.
        inverse: (m, m) the inverse of the matrix of second derivatives, where it is known.
    """
    if not len(begin):
        return begin, float(cost(begin[None])[0])
    steps = np.concatenate([np.zeros((1, len(begin))), STEP * np.eye(len(begin)), -STEP * np.eye(len(begin))])

    def with_slope(x: Array) -> tuple[float, Array]:
        found = cost(x + steps)
        ahead, behind = found[1 : len(x) + 1], found[len(x) + 1 :]
        return float(found[0]), (ahead - behind) / (2.0 * STEP)

    options: Any = {"gtol": 0.02 * math.sqrt(1.0 if inverse is None else 1.0 / max(inverse.max(), 1e-12))}
    if inverse is not None:
        options["hess_inv0"] = inverse
    found = optimize.minimize(with_slope, begin, jac=True, method="BFGS", options=options)
    return np.asarray(found.x), float(found.fun)


def profile_intervals(cost: Cost, at: Array) -> list[Interval]:
    """Return the intervals of all parameters, with 95 % confidence.

    Args:
        cost: minus the log-likelihood, (b, m) angles to (b,).
        at: (m,) the angles where it is least.
    """
    profile = _Profile(cost, at)
    return [_interval(partial(profile.root, i), float(at[i]), profile.spread(i)) for i in range(len(at))]


class _Profile:
    """The root of D of one parameter, by angle; the others' search begins where the nearest one ended."""

    def __init__(self, cost: Cost, at: Array) -> None:
        self.cost, self.at, self.least = cost, at, float(cost(at[None])[0])
        self.curvature = _second_derivatives(cost, at)
        self.found: list[dict[float, tuple[float, Array]]] = [{float(x): (0.0, np.delete(at, i))} for i, x in enumerate(at)]

    def spread(self, i: int) -> float:
        """Standard error of angle i, about."""
        return math.sqrt(_inverse(self.curvature)[i, i])

    def root(self, i: int, angle: float) -> float:
        """Root of D of parameter i."""
        found = self.found[i]
        if angle not in found:
            others = np.delete(np.arange(len(self.at)), i)
            begin = np.clip(found[min(found, key=lambda each: abs(each - angle))][1], APART, RIGHT - APART)
            inverse = _inverse(self.curvature[np.ix_(others, others)])
            at, value = minimum(lambda x: self.cost(np.insert(x, i, angle, axis=1)), begin, inverse)
            found[angle] = math.sqrt(max(0.0, 2.0 * (value - self.least))), at
        return found[angle][0]


def _second_derivatives(cost: Cost, at: Array) -> Array:
    m, step = len(at), 10.0 * STEP
    ways = step * np.eye(m)
    corners = np.array([a * ways[i] + b * ways[j] for i in range(m) for j in range(m) for a in (-1, 1) for b in (-1, 1)])
    signs = np.array([1.0, -1.0, -1.0, 1.0])
    return np.asarray((cost(at + corners).reshape(m, m, 4) @ signs) / (4.0 * step * step), dtype=np.float64)


def _inverse(matrix: Array) -> Array:
    """Inverse of the positive part: a flat direction is as wide as the range."""
    size, ways = np.linalg.eigh(matrix)
    half = ways / np.sqrt(np.maximum(size, 1.0))
    found = half @ half.T
    return np.asarray((found + found.T) / 2.0)


def _interval(root: Callable[[float], float], at: float, spread: float) -> Interval:
    """Both bounds of one parameter; `root` is that of D, by angle."""
    if at <= RIGHT / 2.0:
        low, high = _from_zero(root, at, spread)
        return Interval(low, high)
    low, high = _from_zero(lambda angle: root(RIGHT - angle), RIGHT - at, spread)  # the nearer end is 1
    return Interval(1.0 - high, 1.0 - low)


def _from_zero(root: Callable[[float], float], at: float, spread: float) -> tuple[float, float]:
    """Both bounds of a parameter whose nearer end is 0."""

    def bound(guess: float, end: float, limit: Callable[[float], float]) -> float:
        return _bound(root, at, min(max(guess, 0.0), RIGHT), end, limit, CLOSE * spread)

    def far(_: float) -> float:
        return FAR

    at_zero = math.inf if at > 4.0 * FAR * spread else root(0.0)
    high = bound(at + FAR * spread, RIGHT, far)
    if at_zero > 2.0 * FAR:
        return _square(bound(at - FAR * spread, 0.0, far)), _square(high)
    bend = root(high) ** 2 - 2.0 * root(math.asin(math.sin(high) / math.sqrt(2.0))) ** 2 + at_zero**2
    error = _square(high) / math.sqrt(2.0 * max(bend, 1e-9))

    def near(angle: float) -> float:
        return critical(round(_square(angle) / error, 3))

    low = 0.0 if at_zero <= near(0.0) else bound(0.5 * at, 0.0, near)
    return _square(low), _square(bound(high, RIGHT, near))


def _square(angle: float) -> float:
    return math.sin(angle) ** 2


def _bound(
    root: Callable[[float], float], at: float, guess: float, end: float, limit: Callable[[float], float], close: float
) -> float:
    """Return the angle between `at` and `end` where the root of D is the limit; `end` if it is so nowhere."""
    inside = at
    while (found := root(guess)) < (most := limit(guess)):
        if guess == end:
            return end
        inside, reach = guess, (guess - at) * min(3.0, max(1.02, 1.05 * most / max(found, 1e-3)))
        guess = at + math.copysign(max(abs(reach), close), end - at)
        guess = end if abs(guess - at) >= abs(end - at) else guess
    return float(optimize.brentq(lambda angle: root(angle) - limit(angle), inside, guess, xtol=max(close, 1e-12)))
