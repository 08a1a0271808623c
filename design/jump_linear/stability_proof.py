r"""Mean-square stability proved by positive families, without an eigenvalue.

The operator L of the second moments keeps the cone of positive semidefinite families. So R > 0 with R - L R > 0 proves stability,
and s > radius(L) if and only if

    s X - L X = I    has a solution with every X_i > 0.

Loops that differ little share one R (`StabilityProof`); the radius over many modes with few successors is found by sparse
solutions for some s (`positive_radius`).

On which side of 1 the radius of many modes lies, sums of powers say (`side_of_one`). Let F - L F = Q > 0. If the radius is below
1, F is the sum of all L^j Q, so that F >= Q > 0. If F > 0, L F <= (1 - c) F for some c > 0. So

    F > 0 proves that the radius is below 1,    an F with a negative eigenvalue that it is not.

With X_k = L^k I and S_k = X_0 + ... + X_{k-1}

    S_k - L S_k = I - X_k,    (2 S_e - S_k) - L (2 S_e - S_k) = I - 2 X_e + X_k

The first serves as soon as the norm of a power, |L^k| = max_i |X_k^i|, falls below 1; the second as soon as the moments have
doubled since slot e in every direction in which they have grown. Each F is judged by its own product, beyond rounding. Where none
is found, the radius is nearer to 1 than the budget reaches.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from design.jump_linear.coupled_lyapunov import Array, factors_of, mean, solve_coupled
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


BUDGET = 1_000_000_000
"""Numbers of all products together: some half a minute of an idle core."""
FIRST, SPACING = 8, 1.25
"""Products before the first look at what has grown, and the ratio of each look's number to the last one's."""
HALF, SLACK = 0.5, 0.1
"""Norm of a power below which its sum is judged; what a difference must fall by, as the formula says, before it is judged."""
SHARE = 0.9
"""Power of the growth seen that a search divides by: the rest grows slowly enough that its slots can be distinguished."""
SEARCHES = 6
LARGEST = 1e150


class Side(NamedTuple):
    """On which side of 1 the radius lies; None where no family was found.

    `bound` is one of the radius: from above where it is below 1, else from below. `falls` is the smallest eigenvalue of F - L F,
    `least` that of F, and `rounding` bounds the error of both.
    """

    stable: bool | None
    bound: float
    falls: float
    least: float
    rounding: float


OPEN = Side(None, float("nan"), 0.0, 0.0, 0.0)


def side_of_one(A: Array, transition: Array, budget: int = BUDGET, *, near: bool = True) -> Side:
    """Return on which side of 1 the second-moment radius lies, with a bound of it.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) transition probabilities, or bounds of them.
        budget: numbers of all products together.
        near: look for a bound that is near to a radius above 1, too.
    """
    found, scale, left = OPEN, 1.0, budget // A.size
    for _ in range(SEARCHES):
        side, growth, spent = _searched(A / np.sqrt(scale), transition, left)
        left -= spent
        if side.stable is False:
            found = side._replace(bound=scale * side.bound)
        if scale == 1.0 and (side.stable or (side.stable is False and not near)):
            return side
        if left <= 0 or (scale > 1.0 and side.stable is False) or (not side.stable and not growth > 1.0 + 1e-6):
            return found
        scale = np.sqrt(scale) if side.stable else scale * growth**SHARE  # more was taken off than the radius has
    return found


def _searched(A: Array, transition: Array, most: int) -> tuple[Side, float, int]:
    """The side; by how much per slot the moments have grown, 1 if not at all; and how many products it took."""
    chains, turned = factors_of(transition), np.ascontiguousarray(A.transpose(0, 2, 1))
    modes, n, _ = A.shape
    unit, gain = np.eye(n), max(1.0, float((np.abs(A).sum(axis=2) ** 2).max()))
    lost = 4.0 * n * modes * float(np.finfo(float).eps) * gain

    def moved(family: Array) -> Array:
        found = turned @ mean(chains, family) @ A
        return np.asarray(0.5 * (found + found.transpose(0, 2, 1)))

    def judged(F: Array) -> Side:
        falls, least, size = _least(F - moved(F)), _least(F), float(np.abs(F).max())
        rounding = lost * size
        step = (falls - rounding) / (n * size)
        sure = falls > rounding and abs(least) > rounding
        return Side(least > 0.0 if sure else None, 1.0 - step if least > 0.0 else 1.0 + step, falls, least, rounding)

    S, X, look, growth = np.zeros_like(A), np.array(np.broadcast_to(unit, A.shape)), FIRST, 1.0
    early, then, at = S, X, 0
    for k in range(1, most + 1):
        S, X = S + X, moved(X)
        size = _norm(X)
        if size < HALF and (side := judged(S)).stable is not None:
            return side._replace(bound=min(side.bound, (2.0 * size) ** (1.0 / k))), 1.0, k  # twice: beyond its rounding
        if k < look and size < LARGEST:
            continue
        look, growth = int(SPACING * k) + 1, max(1.0, (size / _norm(then)) ** (1.0 / (k - at)))
        if size < LARGEST and _least(unit - 2.0 * then + X) > SLACK and (side := judged(2.0 * early - S)).stable is not None:
            return side, growth, k
        if not lost * float(np.abs(S).max()) < SLACK:  # what more products add is lost in rounding
            return OPEN, growth, k
        if k >= 2 * at:
            early, then, at = S, X, k
    return OPEN, growth, most


def _norm(family: Array) -> float:
    """The largest trace: at least the largest eigenvalue of a positive family, and at most n of them."""
    return float(np.einsum("ijj->i", family).max())


def _least(family: Array) -> float:
    return float(np.linalg.eigvalsh(family)[:, 0].min())
