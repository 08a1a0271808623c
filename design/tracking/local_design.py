"""Designs for a plant without a network: LQR, LQG and H-infinity, by the Riccati equations of scipy.

A networked design is compared with them.

    z = [C x; rho u],    y = C x + v,    x(k+1) = A x + B (u + w)

All three feed a state back, u = -F x, that a stationary Kalman filter estimates from the sample of this slot:

    lqr    F minimises the sum of |z|^2; the filter takes samples for exact
    lqg    the same F; the filter weighs samples of noise |v| = ``noise`` against disturbances of |w| = 1
    hinf   F keeps the sum of |z|^2 below gamma^2 times that of |w|^2, gamma 5 % above the smallest (game Riccati equation)

Nothing is claimed of the loop that runs: these designs know no delay. The certifiers judge them over the network like any other.

Reference: B. Anderson, J. Moore, Optimal Control: Linear Quadratic Methods; T. Basar, P. Bernhard, H-infinity-Optimal Control.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from design.controllers import LinearLaw
from design.errors import DesignError, check_above_zero

LocalMethod = Literal["lqr", "lqg", "hinf"]
Array = npt.NDArray[np.float64]

EXACT = 1e-4
"""The noise of a sample that the filter of ``lqr`` takes for exact, in units of the output."""
ABOVE = 1.05
"""gamma asked of ``hinf``, as a multiple of the smallest."""


def local_design(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    method: LocalMethod,
    *,
    input_weight: float = 0.01,
    noise: float = 0.01,
) -> LinearLaw:
    """Return a controller for a plant without a network.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.
        method: "lqr", "lqg" or "hinf".
        input_weight: rho, in output units per input unit.
        noise: standard deviation of a sample per unit of the input disturbance's (``lqg`` and ``hinf``).

    Raises:
        FieldError: a weight that is not a finite number above 0.
        DesignError: the Riccati equation has no stabilising solution.
    """
    A_, B_, C_ = (np.asarray(M, dtype=np.float64) for M in (A, B, C))
    check_above_zero(input_weight=input_weight, noise=noise)
    F = game_feedback(A_, B_, C_, input_weight) if method == "hinf" else lqr_feedback(A_, B_, C_, input_weight)
    filtered = _filter(A_, B_, C_, EXACT if method == "lqr" else noise)
    # xi+ = xi + L (e - C xi) is the state as the newest sample shows it; u = -F xi+; xi(k+1) = A xi+ + B u
    keep, closed = np.eye(len(A_)) - filtered @ C_, A_ - B_ @ F
    return LinearLaw(A=closed @ keep, B=closed @ filtered, C=-F @ keep, D=-F @ filtered)


def lqr_feedback(A: Array, B: Array, C: Array, input_weight: float) -> Array:
    """Return F (m, n) of u = -F x that minimises the sum of |C x|^2 + rho^2 |u|^2.

    Raises:
        DesignError: there is no stabilising one.
    """
    R = input_weight**2 * np.eye(B.shape[1])
    X = _riccati("lqr", A, B, C.T @ C, R)
    F = np.asarray(np.linalg.solve(B.T @ X @ B + R, B.T @ X @ A), dtype=np.float64)
    _stable(A - B @ F, "lqr")
    return F


def game_feedback(A: Array, B: Array, C: Array, input_weight: float) -> Array:
    """Return F (m, n) of u = -F x with |z| < gamma |w| for every w, gamma 5 % above the smallest.

    Raises:
        DesignError: no gamma was found.
    """
    high = 1.0
    while (F := _at_gamma(A, B, C, input_weight, high)) is None:
        high *= 2.0
        if high > 1e9:
            raise DesignError("hinf: the game Riccati equation has no stabilising solution for gamma up to 1e9", value=high)
    low = 0.0
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _at_gamma(A, B, C, input_weight, middle) is None else (low, middle)
    F = _at_gamma(A, B, C, input_weight, ABOVE * high)
    if F is None:
        raise DesignError(f"hinf: the game Riccati equation has no stabilising solution at gamma = {ABOVE * high:g}", value=high)
    return F


def _at_gamma(A: Array, B: Array, C: Array, input_weight: float, gamma: float) -> Array | None:
    """F of the saddle point (u, w) of sum |z|^2 - gamma^2 |w|^2, None where there is none."""
    m = B.shape[1]
    both = np.hstack([B, B])
    weight = np.diag(np.concatenate([np.full(m, input_weight**2), np.full(m, -(gamma**2))]))
    try:
        X = _riccati("hinf", A, both, C.T @ C, weight)
    except DesignError:
        return None
    if not np.isfinite(X).all() or np.linalg.eigvalsh(0.5 * (X + X.T)).min() < -1e-9 * np.abs(X).max():
        return None
    if np.linalg.eigvalsh(gamma**2 * np.eye(m) - B.T @ X @ B).min() <= 0.0:
        return None
    gains = np.linalg.solve(weight + both.T @ X @ both, both.T @ X @ A)
    F = np.asarray(gains[:m], dtype=np.float64)
    worst = A - both @ gains
    return F if max(np.abs(np.linalg.eigvals(M)).max() for M in (A - B @ F, worst)) < 1.0 else None


def _filter(A: Array, B: Array, C: Array, noise: float) -> Array:
    """The gain (n, p) by which a sample corrects the state: P C' (C P C' + V)^-1, P of a prediction."""
    V = noise**2 * np.eye(C.shape[0])
    P = _riccati("filter", A.T, C.T, B @ B.T, V)
    L = np.asarray(np.linalg.solve(C @ P @ C.T + V, C @ P).T, dtype=np.float64)
    _stable(A @ (np.eye(len(A)) - L @ C), "filter")
    return L


def _riccati(what: str, A: Array, B: Array, Q: Array, R: Array) -> Array:
    """X = A'XA - A'XB (R + B'XB)^-1 B'XA + Q."""
    from scipy.linalg import solve_discrete_are

    try:
        return np.asarray(solve_discrete_are(A, B, Q, R), dtype=np.float64)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise DesignError(f"{what}: the Riccati equation has no stabilising solution ({error})") from error


def _stable(closed: Array, what: str) -> None:
    """Refuse a solution that leaves a mode as it is: scipy returns one where a mode is not reached, or not seen."""
    radius = float(np.abs(np.linalg.eigvals(closed)).max())
    if radius >= 1.0:
        raise DesignError(f"{what}: the spectral radius is {radius:.6g}, expected below 1", value=radius)
