r"""On which side of 1 the second-moment radius of many modes lies, by sums of powers alone: products, and no eigenvalue.

The operator L of the second moments keeps the cone of positive semidefinite families. Let F - L F = Q > 0. If the radius is below
1, F is the sum of all L^j Q, so that F >= Q > 0. If F > 0, L F <= (1 - c) F for some c > 0. So

    F > 0 proves that the radius is below 1,    an F with a negative eigenvalue that it is not.

With X_k = L^k I and S_k = X_0 + ... + X_{k-1}

    S_k - L S_k = I - X_k,    (2 S_e - S_k) - L (2 S_e - S_k) = I - 2 X_e + X_k

The first serves as soon as the norm of a power, |L^k| = max_i |X_k^i|, falls below 1; the second as soon as the moments have
doubled since slot e in every direction in which they have grown. Each F is judged by its own product, beyond rounding. Where none
is found, the radius is nearer to 1 than the budget reaches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.jump_linear.joint_expectation import Array, factors_of, mean

BUDGET = 1_000_000_000
"""Numbers of all products together: some half a minute of an idle core."""
FIRST, SPACING = 8, 1.25
"""Products before the first look at what has grown, and the ratio of each look's number to the last one's."""
HALF, SLACK = 0.5, 0.1
"""Norm of a power below which its sum is judged; what a difference must fall by, as the formula says, before it is judged."""
SHARE = 0.9
"""Power of the growth seen, that a search takes off: what is left grows slowly enough for its own slots to be told apart."""
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


def side_of_one(A: Array, transition: Array, budget: int = BUDGET) -> Side:
    """Return on which side of 1 the second-moment radius lies, with a bound of it.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) transition probabilities, or bounds of them.
        budget: numbers of all products together.
    """
    found, scale, left = OPEN, 1.0, budget // A.size
    for _ in range(SEARCHES):
        side, growth, spent = _searched(A / np.sqrt(scale), transition, left)
        left -= spent
        if side.stable is False:
            found = side._replace(bound=scale * side.bound)
        if scale == 1.0 and side.stable:
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
            return side._replace(bound=min(side.bound, (2.0 * size) ** (1.0 / k))), 1.0, k + 1  # twice: beyond its rounding
        if k < look and size < LARGEST:
            continue
        look, growth = int(SPACING * k) + 1, max(1.0, (size / _norm(then)) ** (1.0 / (k - at)))
        if size < LARGEST and _least(unit - 2.0 * then + X) > SLACK and (side := judged(2.0 * early - S)).stable is not None:
            return side, growth, k + 1
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
