r"""Whether the mean of squared errors has a variance: the growth of fourth moments, E |x(k)|^4 of a jump-linear system.

The coordinates eta of x x' follow eta(k+1) = W_i eta(k), a jump-linear system again, whose second moments are the fourth moments
of x (every symmetric matrix is a sum of multiples of x x', so that no other start of eta grows faster). In eta's second moments

    (L S)_i = W_i' (sum_j p_ij S_j) W_i

keeps the cone of positive semidefinite families. Its radius is below 1 if and only if S - L S = I has a solution with S > 0,
which is what decides; the number is the largest eigenvalue, of large systems the growth of L^k I.
Mean-square stable with this radius above 1: squared errors have a mean and no variance, and the mean of n runs does not
approach it like 1 / sqrt(n).

Forms of any degree in the state say what the mean of a power of a signal is, as a function of where the state begins:

    V(x) = sum_alpha c_alpha x^alpha,  |alpha| = degree;    V(A x) = sum_alpha c_alpha (A x)^alpha

With z(x) the monomials x^alpha, z(A x) = A^[degree] z(x), so that c of V(A x) is A^[degree]' c. By recursion over the degree,

    (A x)^alpha = (a_i x) (A x)^(alpha - e_i),    i the first variable in alpha.

Reference: R. W. Brockett, Lie algebras and Lie groups in control theory, 1973 (A^[p]).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations_with_replacement
from math import comb
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.jump_linear.second_moment import Array, backward, congruence_matrices, cost_once, like_units, mean_square_radius
from design.jump_linear.stability_proof import side_of_one

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
MOST_PRODUCTS = 300
"""Where the equation has no accurate solution, as of a controller's own states in any units, products decide."""


class FourthMoments(Struct, frozen=True, kw_only=True):
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
    if proved is None and (unit := like_units(A)) is not None:  # as of a controller's own state, whose units say nothing
        return fourth_moments(A * unit / unit[:, None], transition, upper=upper)
    if below and upper is not None:
        return FourthMoments(radius=None, state="undecided", reason="the tail of a sojourn law decides")
    return FourthMoments(radius=None, state="undecided", reason=f"rounding hides whether {moments} moments grow")


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
    """Whether the radius is below 1, by the solution of S - L S = I, or by products; None where neither is accurate enough."""
    unit = np.array(np.broadcast_to(np.eye(W.shape[-1]), W.shape))
    S = cost_once(W, transition, unit)
    size = float(np.abs(S).max())
    if not float(np.abs(S - backward(W, transition, S) - unit).max()) <= ACCURATE * max(size, 1.0):
        return side_of_one(W, transition, MOST_PRODUCTS * W.size, near=False).stable
    least = float(np.linalg.eigvalsh(0.5 * (S + S.transpose(0, 2, 1))).min())
    return True if least > 0.5 and size < MOST_SIZE else False if least < -ACCURATE * size else None


def _growth(W: Array, transition: Array) -> float | None:
    """Growth per slot of L^k I, of moments that do not die out; None where it has not settled within the limit of work."""
    modes, size, _ = W.shape
    products = int(MOST_FLOPS / (4.0 * modes * size**3 + 2.0 * modes**2 * size**2))
    family, before = np.array(np.broadcast_to(np.eye(size), W.shape)), np.inf
    for _ in range(products // BLOCK):
        total = 0.0
        for _ in range(BLOCK):
            family = backward(W, transition, family)
            norm = float(np.abs(family).max())
            family /= norm
            total += np.log(norm)
        if abs(total - before) < SETTLED * BLOCK:
            return float(np.exp(total / BLOCK))
        before = total
    return None


Index = npt.NDArray[np.intp]


class Degree(NamedTuple):
    """Monomials of one degree: the first variable of each, the monomial without it, and by variable where x_v times those lie."""

    first: Index
    parent: Index
    times: Index


def count(variables: int, degree: int) -> int:
    """Return how many monomials there are.

    >>> count(2, 4)
    5
    """
    return comb(variables + degree - 1, degree)


@lru_cache(maxsize=16)
def monomials(variables: int, degree: int) -> tuple[Degree, ...]:
    """Return the monomials of degree 1, 2, ..., in so many variables, each built on those of the degree before."""
    found: list[Degree] = []
    before: dict[tuple[int, ...], int] = {(): 0}
    for k in range(1, degree + 1):
        words = list(combinations_with_replacement(range(variables), k))
        place = {word: i for i, word in enumerate(words)}
        times = [[place[tuple(sorted((*word, v)))] for word in before] for v in range(variables)]
        first, parent = [word[0] for word in words], [before[word[1:]] for word in words]
        found.append(Degree(np.array(first), np.array(parent), np.array(times)))
        before = place
    return tuple(found)


def power(A: Array, degree: int) -> Any:
    """Return A^[degree] with z(A y) = A^[degree] z(y), a sparse array (count(n, degree), count(k, degree)).

    Args:
        A: (n, k).
        degree: of the monomials, at least 1.

    >>> power(np.array([[2.0]]), 3).toarray().tolist()
    [[8.0]]
    """
    return powers(A, degree)[0]


def powers(A: Array, *degrees: int) -> list[Any]:
    """Return A^[degree] of several increasing degrees, see `power`: the larger ones are made of the smaller ones.

    Args:
        A: (n, k).
        degrees: of the monomials, at least 1.
    """
    from scipy.sparse import csr_array  # where a command has no limits, it is not needed

    return [
        csr_array((values, (row, column)), shape=(count(A.shape[0], degree), count(A.shape[1], degree)))
        for degree, (row, column, values) in zip(degrees, power_entries(A, *degrees))
    ]


def power_entries(A: Array, *degrees: int) -> list[tuple[Index, Index, Array]]:
    """Return row, column and value of every entry of A^[degree] that is not zero, row by row.

    Of a delayed packet, which only moves on, one entry of a row of A acts: few entries of its powers do.

    Args:
        A: (n, k).
        degrees: of the monomials, increasing, at least 1.
    """
    row: Index = np.zeros(1, np.intp)
    column, values, found_of = row, np.ones(1), []
    each_degree = zip(monomials(A.shape[0], degrees[-1]), monomials(A.shape[1], degrees[-1]), strict=True)
    for degree, (rows, columns) in enumerate(each_degree, start=1):
        begin, end = np.searchsorted(row, [rows.parent, rows.parent + 1])
        before = np.concatenate([np.arange(a, b) for a, b in zip(begin, end)])
        row, width = np.repeat(np.arange(len(rows.first)), end - begin), len(columns.first)
        found = (A[rows.first[row]] * values[before, None]).T.ravel()  # by variable
        place = (row * width + columns.times[:, column[before]]).ravel()
        acts = found != 0.0
        place, which = np.unique(place[acts], return_inverse=True)
        row, column = np.divmod(place, width)
        values = np.asarray(np.bincount(which, found[acts]), dtype=np.float64)
        if degree in degrees:
            found_of.append((row, column, values))
    return found_of


def power_of_row(row: Array, degree: int) -> Array:
    """Return the coefficients of (row x)^degree, (count(n, degree),)."""
    found = np.ones(1)
    for each in monomials(len(row), degree):
        grown = np.zeros(len(each.first))
        for v, times in enumerate(each.times):
            grown[times] += row[v] * found
        found = grown
    return found


def at(vectors: Array, degree: int) -> Array:
    """Return the monomials of a vector, (count(n, degree),), or of the columns of a matrix."""
    found = np.ones((1, *vectors.shape[1:]))
    for each in monomials(len(vectors), degree):
        found = vectors[each.first] * found[each.parent]
    return found
