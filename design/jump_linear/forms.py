r"""Forms of any degree in the state: what the mean of a power of a signal is, as a function of where the state begins.

    V(x) = sum_alpha c_alpha x^alpha,  |alpha| = degree;    V(A x) = sum_alpha c_alpha (A x)^alpha

With z(x) the monomials x^alpha, z(A x) = A^[degree] z(x), so that c of V(A x) is A^[degree]' c. By recursion over the degree,

    (A x)^alpha = (a_i x) (A x)^(alpha - e_i),    i the first variable in alpha.

Reference: R. W. Brockett, Lie algebras and Lie groups in control theory, 1973 (A^[p]).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations_with_replacement
from math import comb
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from design.jump_linear.second_moment import Array

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

    Of a delayed packet, which only moves on, one entry of a row of A acts: few entries of its powers do.

    Args:
        A: (n, k).
        degree: of the monomials, at least 1.

    >>> power(np.array([[2.0]]), 3).toarray().tolist()
    [[8.0]]
    """
    from scipy.sparse import csr_array  # where a command has no limits, it is not needed

    R = csr_array(np.ones((1, 1)))
    for rows, columns in zip(monomials(A.shape[0], degree), monomials(A.shape[1], degree), strict=True):
        before = R[rows.parent]
        shape = (len(rows.first), len(columns.first))
        R = csr_array(shape)
        for v in range(A.shape[1]):
            values = before.data * np.repeat(A[rows.first, v], np.diff(before.indptr))
            grown = csr_array((values, columns.times[v][before.indices], before.indptr.copy()), shape=shape)
            grown.eliminate_zeros()
            R = R + grown
    return R


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
