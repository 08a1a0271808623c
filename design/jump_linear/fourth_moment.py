r"""Whether the mean of squared errors has a variance: the growth of fourth moments, E |x(k)|^4 of a jump-linear system.

The coordinates eta of x x' follow eta(k+1) = W_i eta(k), a jump-linear system again, whose second moments are the fourth moments
of x (every symmetric matrix is a sum of multiples of x x', so that no other start of eta grows faster). In eta's second moments

    (L S)_i = W_i' (sum_j p_ij S_j) W_i

keeps the cone of positive semidefinite families. Its radius is below 1 if and only if S - L S = I has a solution with S > 0,
which is what decides; the number is the largest eigenvalue, of large systems the growth of L^k I.
Mean-square stable with this radius above 1: squared errors have a mean and no variance, and the mean of n runs does not
approach it like 1 / sqrt(n).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from design.jump_linear.second_moment import Array, backward, congruence_matrices, cost_once, mean_square_radius

MOST_FLOPS = 1e10
"""Of the products for the number: some 0.5 s of one core."""

EXACT = 700
"""Moments up to which all eigenvalues are computed."""

MOST_MOMENTS = 20_000
"""Moments up to which it is decided: some seconds."""

BLOCK = 25
SETTLED = 1e-9
"""Change of the growth per slot, from one block of products to the next, at which it is shown as the radius."""

ACCURATE, MOST_SIZE = 1e-8, 1e12


@dataclass(frozen=True, slots=True, kw_only=True)
class FourthMoments:
    """What is known of the fourth moments.

    Args:
        radius: by what E |x|^4 grows in a slot, above 1; None where it does not, or was not found within the limit of work.
        state: ``bounded``, ``growing`` or ``undecided``.
        reason: why it is undecided, else empty.
    """

    radius: float | None
    state: Literal["bounded", "growing", "undecided"]
    reason: str = ""


def fourth_moments(A: Array, transition: Array, *, upper: Array | None = None) -> FourthMoments:
    """Return how the fourth moments of a jump-linear system grow.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) row-stochastic matrix.
        upper: (N, N) upper bounds of the transition probabilities, where a mode stands for a tail that is cut: growth over the
            cut chain refutes, no growth over the bounds proves.
    """
    s = A.shape[-1] * (A.shape[-1] + 1) // 2
    if (moments := A.shape[0] * s * (s + 1) // 2) > MOST_MOMENTS:
        return FourthMoments(radius=None, state="undecided", reason=f"{moments} moments are too many to tell")
    W = _of_products(A)[0]
    below = _below_one(W, transition)
    if below is False:
        return FourthMoments(radius=fourth_moment_radius(A, transition), state="growing")
    proved = below if upper is None else _below_one(W, upper)
    if proved:
        return FourthMoments(radius=None, state="bounded")
    if below and upper is not None:
        return FourthMoments(radius=None, state="undecided", reason="the tail of a sojourn law decides")
    return FourthMoments(radius=None, state="undecided", reason=f"{moments} moments grow too little to tell")


def fourth_moment_radius(A: Array, transition: Array) -> float | None:
    """Return by what E |x|^4 of a jump-linear system grows in a slot; None where it was not found within the limit of work.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) row-stochastic matrix.
    """
    W, moments = _of_products(A)
    return mean_square_radius(W, transition) if moments <= EXACT else _growth(W, transition)


def _of_products(A: Array) -> tuple[Array, int]:
    """The mode matrices of the system whose state is eta, and how many fourth moments it has."""
    W = congruence_matrices(A).transpose(0, 2, 1)  # eta -> coordinates of A x x' A'
    return W, W.shape[0] * W.shape[1] * (W.shape[1] + 1) // 2


def _below_one(W: Array, transition: Array) -> bool | None:
    """Whether the radius is below 1, by the solution of S - L S = I; None where none was found that is accurate enough."""
    unit = np.array(np.broadcast_to(np.eye(W.shape[-1]), W.shape))
    S = cost_once(W, transition, unit)
    if not np.isfinite(S).all():
        return None
    size = float(np.abs(S).max())
    if float(np.abs(S - backward(W, transition, S) - unit).max()) > ACCURATE * max(size, 1.0):
        return None
    least = float(np.linalg.eigvalsh(0.5 * (S + S.transpose(0, 2, 1))).min())
    return True if least > 0.5 and size < MOST_SIZE else False if least < -ACCURATE * size else None


def _growth(W: Array, transition: Array) -> float | None:
    """Growth per slot of L^k I; None where it has not settled within the limit of work."""
    modes, size, _ = W.shape
    products = int(MOST_FLOPS / (4.0 * modes * size**3 + 2.0 * modes**2 * size**2))
    family, before = np.array(np.broadcast_to(np.eye(size), W.shape)), np.inf
    for _ in range(products // BLOCK):
        total = 0.0
        for _ in range(BLOCK):
            family = backward(W, transition, family)
            norm = float(np.abs(family).max())
            if not 0.0 < norm < np.inf:
                return 0.0 if norm == 0.0 else None
            family /= norm
            total += np.log(norm)
        if abs(total - before) < SETTLED * BLOCK:
            return float(np.exp(total / BLOCK))
        before = total
    return None
