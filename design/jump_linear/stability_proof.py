"""Mean-square stability proved by positive solutions, without an eigenvalue.

The operator L of the second moments keeps the cone of positive semidefinite families. So R > 0 with R - L R > 0 proves stability,
and s > radius(L) if and only if

    s X - L X = I    has a solution with every X_i > 0.

Loops that differ little share one R (`StabilityProof`); the radius over many modes with few successors is found by sparse
solutions for some s (`positive_radius`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from design.jump_linear.coupled_lyapunov import solve_coupled
from design.jump_linear.joint_expectation import Array, factors_of, mean
from design.jump_linear.long_computations import apart

TOLERANCES = (1e-4, 1e-12)


class StabilityProof:
    """Keeps the last family that proved stability.

    One equation solved to few digits gives such an R; a product shows whether it still fits the next loop.

    Args:
        transition: (N, N) row-stochastic matrix.
    """

    def __init__(self, transition: Array) -> None:
        self._factors = factors_of(transition)
        self._family: Array | None = None
        self._expected: Array | None = None

    def holds(self, A: Array) -> bool:
        """Whether the mode matrices (N, n, n) are proved mean-square stable; False where they are not, or too near to tell."""
        turned = np.ascontiguousarray(A.transpose(0, 2, 1))
        if self._family is not None and self._falls(self._family, A, turned):
            return True
        identity = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
        for tolerance in TOLERANCES:
            expected = solve_coupled(turned, self._factors, identity, tolerance=tolerance, near=self._expected)
            if expected is None:
                return False
            family = turned @ expected @ A + identity
            if self._falls(family, A, turned):
                if not is_positive(family):
                    return False
                self._family, self._expected = family, expected
                return True
        return False

    def _falls(self, family: Array, A: Array, turned: Array) -> bool:
        return is_positive(family - turned @ mean(self._factors, family) @ A)


def is_positive(family: Array) -> bool:
    """Whether every matrix of a symmetric family (N, n, n) is positive definite."""
    if not np.isfinite(family).all():
        return False
    try:
        np.linalg.cholesky(family)
    except np.linalg.LinAlgError:
        return False
    return True


MOST_ENTRIES = 3_000_000
"""Entries of the sparse matrix; more of them fill the memory when it is factored."""
DENSITY = 0.05
"""Share of entries that are not zero up to which a sparse factorisation pays."""
QUICK = 100_000
"""Entries that are factored in a moment; more take up to some seconds, in which no signal is seen."""
ACCURATE = 1e-11
MOST_SOLUTIONS = 60


def is_sparse(transition: Array, n: int) -> bool:
    """Return whether few enough transitions are possible for what this file computes.

    Args:
        transition: (N, N).
        n: states.
    """
    count, size = int(np.count_nonzero(transition)), n * (n + 1) // 2
    return count <= DENSITY * transition.size and count * size * size <= MOST_ENTRIES


def sparse_operator(congruences: Array, transition: Array) -> Any:
    """Return the backward operator as a sparse matrix of scipy, (N s, N s).

    Args:
        congruences: (N, s, s) matrices of S -> A_i' S A_i in coordinates.
        transition: (N, N).
    """
    from scipy.sparse import bsr_array

    i, j = np.nonzero(transition)
    size = congruences.shape[1]
    starts = np.concatenate([[0], np.cumsum(np.bincount(i, minlength=len(transition)))])
    shape = (len(transition) * size, len(transition) * size)
    return bsr_array((transition[i, j][:, None, None] * congruences[i], j, starts), shape=shape).tocsc()


def solve_sparse(operator: Any, right: Array, shift: float = 1.0) -> Array:
    """Return x with shift x - L x = right, (size,) or (size, k); not a number throughout where the matrix is singular."""
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    matrix = (shift * eye_array(operator.shape[0], format="csc") - operator).tocsc()

    def solved() -> Array:
        try:
            return np.asarray(splu(matrix).solve(right))
        except RuntimeError:  # exactly singular
            return np.full_like(right, np.nan)

    return apart(solved) if matrix.nnz > QUICK else solved()


def positive_radius(operator: Any, unit: Array, family: Any) -> float:
    """Return the spectral radius of an operator that keeps the cone, from above.

    Each s is one sparse factorisation, and 1/tr X falls to zero at the radius like a straight line: a secant finds it, a positive
    solution bounds it from above. No eigenvalue is computed, so none can be missed.

    Args:
        operator: sparse matrix of it, (size, size).
        unit: coordinates of the family of unit matrices, (size,).
        family: makes the matrices (N, n, n) of coordinates.
    """

    def inverse_trace(s: float) -> float:
        """1/tr X(s), 0 where X(s) is not positive: s is at or below the radius."""
        x = solve_sparse(operator, unit, s)
        return 1.0 / float(x @ unit) if is_positive(family(x)) else 0.0

    low, high = 0.0, 1.0
    f_high = inverse_trace(high)
    while not f_high and high < 1e12:
        low, high = high, 2.0 * high
        f_high = inverse_trace(high)
    before, f_before = 2.0 * high, inverse_trace(2.0 * high)
    for _ in range(MOST_SOLUTIONS):
        if high - low <= ACCURATE * high:
            break
        slope = (f_before - f_high) / (before - high)
        root = high - f_high / slope if slope > 0.0 else low
        aim = root + 0.02 * (high - root) if low < root < high else 0.5 * (low + high)
        aim = aim if low < aim < high else 0.5 * (low + high)
        f = inverse_trace(aim)
        if f:
            before, f_before, high, f_high = high, f_high, aim, f
            if high - root <= ACCURATE * high and root > low:
                break
        else:
            low = aim
    return high
