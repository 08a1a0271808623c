"""GMRES for the second-moment operator, with an end.

scipy's GMRES spends two thirds of its time in Python around products of 20 to 50 us, and on the edge of stability it runs for
thousands of products and then returns a vector that misses its tolerance. This one keeps its basis in one array and says
when it has not converged: then the operator has an eigenvalue so near 1 that the loop counts as not stable there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

PRODUCTS = 240
"""Most products of one solve. Loops of radius 0.99 with 12,000 unknowns take about 100."""

ACCEPTABLE = 1e-9
"""Residual that will do where rounding lets it fall no further."""


def solve(
    apply: Callable[[Array], Array],
    right: Array,
    *,
    tolerance: float = 1e-13,
    acceptable: float = ACCEPTABLE,
    basis: int = 120,
    start: Array | None = None,
) -> Array | None:
    """Return x with apply(x) = right, or None if it was not found within `PRODUCTS` products.

    Args:
        apply: the matrix, (size,) -> (size,), such as I - L.
        right: (size,).
        tolerance: residual to reach, as a share of |right|.
        acceptable: residual that will do where rounding lets it fall no further.
        basis: vectors kept before a restart.
        start: (size,) a guess of x; default zero.
    """
    scale = float(np.linalg.norm(right))
    if scale == 0.0:
        return np.zeros_like(right)
    x, residual, spent = np.zeros_like(right), right, 0
    if start is not None:
        x, residual, spent = start, right - apply(start), 1
        if float(np.linalg.norm(residual)) <= tolerance * scale:
            return x
    while True:
        step, used = _cycle(apply, residual, tolerance * scale, min(basis, PRODUCTS - spent))
        x, spent = x + step, spent + used + 1
        new = right - apply(x)
        size, before = float(np.linalg.norm(new)), float(np.linalg.norm(residual))
        residual = new
        if not np.isfinite(size):
            return None
        if size <= tolerance * scale:
            return x
        if spent >= PRODUCTS - 1 or size > 0.5 * before:  # rounding lets it fall no further, or it does not converge
            return x if size <= max(acceptable, tolerance) * scale else None


def _cycle(apply: Callable[[Array], Array], residual: Array, goal: float, most: int) -> tuple[Array, int]:
    """One cycle from zero: the correction, and how many products it took."""
    beta = float(np.linalg.norm(residual))
    V = np.empty((most + 1, residual.size))
    H = np.zeros((most + 1, most))
    rotation: list[tuple[float, float]] = []
    rest = [beta]
    V[0] = residual / beta
    used = 0
    for k in range(most):
        w = apply(V[k])
        known = V[: k + 1]
        total = np.zeros(k + 1)
        for _ in range(2):  # Gram-Schmidt twice is orthogonal to rounding
            share = known @ w
            w -= share @ known
            total += share
        length = float(np.sqrt(w @ w))
        column: list[float] = total.tolist()
        for i, (c, s) in enumerate(rotation):
            upper, lower = column[i], column[i + 1]
            column[i], column[i + 1] = c * upper + s * lower, c * lower - s * upper
        radius = float(np.hypot(column[k], length))
        used = k + 1
        if not radius > 0.0:
            return np.full_like(residual, np.nan), used
        c, s = column[k] / radius, length / radius
        column[k] = radius
        rotation.append((c, s))
        H[: k + 1, k] = column
        rest[k:] = [c * rest[k], -s * rest[k]]
        if abs(rest[k + 1]) <= goal or length == 0.0:
            break
        V[k + 1] = w / length
    y = np.linalg.solve(H[:used, :used], np.array(rest[:used]))
    return y @ V[:used], used
