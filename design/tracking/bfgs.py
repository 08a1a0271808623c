"""Quasi-Newton descent that takes functions with kinks and with walls: BFGS with a weak Wolfe line search.

A function returns (value, gradient), or (inf, anything) outside its domain; the line search then shortens the step.
On a function with kinks (an H-infinity norm) BFGS with this line search keeps converging where one with the strong
conditions stops, and its Hessian learns the kink's directions.

Reference: Lewis and Overton, Nonsmooth optimization via quasi-Newton methods, Mathematical Programming 141, 2013.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Objective = Callable[[Array], tuple[float, Array]]

ARMIJO = 1e-4
CURVATURE = 0.5

UNSEEN = 1e-14
"""A step that promises less than this share of the value is not tried: rounding would hide what it gains."""


class Descent(NamedTuple):
    """Where a descent ended: point, value, gradient, number of iterations and of evaluations, and why."""

    x: Array
    value: float
    gradient: Array
    iterations: int
    evaluations: int
    reason: str


def bfgs(
    objective: Objective,
    start: Array,
    *,
    iterations: int = 500,
    gradient_tolerance: float = 1e-9,
    value_tolerance: float = 1e-12,
    patience: int = 3,
    stop: Callable[[float], bool] | None = None,
    ceiling: Callable[[float], None] | None = None,
    metric: Callable[[Array], Array] | None = None,
) -> Descent:
    """Minimise from `start`, a point of the domain.

    Args:
        objective: x -> (value, gradient); inf outside the domain.
        gradient_tolerance: stop where the gradient is below it, relative to max(1, |value|).
        value_tolerance, patience: stop after `patience` iterations that each gained relatively less than this.
        stop: asked with each new value; True ends the descent.
        ceiling: called with every value that is not to be exceeded from now on: above it the objective may answer inf.
        metric: x -> first guess of the inverse Hessian at x, where the objective was evaluated last; positive definite. Without,
            a multiple of the identity, fitted to the first step.
    """
    x = np.array(start, dtype=np.float64)
    value, gradient = objective(x)
    evaluations, idle, fresh = 1, 0, True
    if not np.isfinite(value):
        return Descent(x, value, gradient, 0, 1, "start outside the domain")
    if ceiling is not None:
        ceiling(value)
    H = _steepest(gradient, 0.1 * max(1.0, float(np.linalg.norm(x)))) if metric is None else metric(x)
    for iteration in range(1, iterations + 1):
        if np.linalg.norm(gradient) <= gradient_tolerance * max(1.0, abs(value)):
            return Descent(x, value, gradient, iteration - 1, evaluations, "gradient")
        direction = -H @ gradient
        slope = float(gradient @ direction)
        if not slope < 0.0:
            H, fresh = _steepest(gradient, 1.0), True
            direction = -H @ gradient
            slope = float(gradient @ direction)
        if -slope <= UNSEEN * abs(value):
            return Descent(x, value, gradient, iteration - 1, evaluations, "no more gain")
        found, tried = _weak_wolfe(objective, x, value, slope, direction)
        evaluations += tried
        if found is None:
            if fresh:
                return Descent(x, value, gradient, iteration, evaluations, "line search")
            H, fresh = _steepest(gradient, 1e-3), True
            continue
        new_x, new_value, new_gradient = found
        s, y = new_x - x, new_gradient - gradient
        product = float(s @ y)
        if product > 1e-14 * np.linalg.norm(s) * np.linalg.norm(y):
            if fresh and iteration == 1 and metric is None:
                H = np.eye(x.size) * product / float(y @ y)
            Hy = H @ y
            H += (1.0 + float(y @ Hy) / product) / product * np.outer(s, s)
            H -= (np.outer(Hy, s) + np.outer(s, Hy)) / product
            fresh = False
        idle = idle + 1 if value - new_value <= value_tolerance * max(1e-12, abs(value)) else 0
        x, value, gradient = new_x, new_value, new_gradient
        if ceiling is not None:
            ceiling(value)
        if stop is not None and stop(value):
            return Descent(x, value, gradient, iteration, evaluations, "stopped")
        if idle >= patience:
            return Descent(x, value, gradient, iteration, evaluations, "no more gain")
    return Descent(x, value, gradient, iterations, evaluations, "iterations")


def _steepest(gradient: Array, length: float) -> Array:
    """The inverse Hessian by which the first step goes down the gradient so far."""
    return np.asarray(np.eye(gradient.size) / max(1e-300, float(np.linalg.norm(gradient))) * length)


def _weak_wolfe(
    objective: Objective, x: Array, value: float, slope: float, direction: Array
) -> tuple[tuple[Array, float, Array] | None, int]:
    """A step with sufficient decrease and a slope that has risen, by bisection and doubling."""
    low, high, step = 0.0, np.inf, 1.0
    best: tuple[Array, float, Array] | None = None
    for tried in range(1, 36):
        point = x + step * direction
        new_value, new_gradient = objective(point)
        if not np.isfinite(new_value) or new_value > value + ARMIJO * step * slope:
            high = step
        else:
            best = (point, new_value, new_gradient)
            if float(new_gradient @ direction) >= CURVATURE * slope:
                return best, tried
            low = step
        if high - low <= 1e-14 * max(1.0, high if np.isfinite(high) else low):
            break
        step = 0.5 * (low + high) if np.isfinite(high) else 2.0 * low
    return best, tried
