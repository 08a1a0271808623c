"""Products and inverses of small matrices whose bits are the same on every machine: no BLAS, nothing fused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Return 0 + a_1 b_1 + a_2 b_2 + ..., rounded after every step in this order (`sum` rounds otherwise from Python 3.12 on)."""
    total = 0.0
    for x, y in zip(a, b):
        total += x * y
    return total


def product(rows: Sequence[Sequence[float]], x: Sequence[float]) -> list[float]:
    """Return a matrix of rows times x, each entry as `dot` gives it.

    Products are summed in one order.

    >>> product([[1.0, 2.0], [0.0, 1.0]], [3.0, 4.0])
    [11.0, 4.0]
    """
    return [dot(row, x) for row in rows]


def product_of_batch(
    rows: Sequence[Sequence[float]], x: Sequence[NDArray[np.float64]] | NDArray[np.float64]
) -> NDArray[np.float64]:  # fmt: skip
    """Return the products of a matrix (m, n) with many x (n, runs): (m, runs), each bit for bit as `product` gives it."""
    out = np.zeros((len(rows), len(x[0])))
    for total, row in zip(out, rows):
        for a, column in zip(row, x):
            total += a * column
    return out


Matrix = NDArray[np.float64]
Whole = list[list[int]]

LARGEST: Final = 24
"""Rows and columns up to which whole numbers are used: 0.1 s."""


def of_size_one(N: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a matrix in units of its rows and columns in which they have size 1."""
    for axis in (0, 1, 0, 1):
        size = np.abs(N).max(axis=axis, keepdims=True)
        N = N / np.where(size > 0.0, size, 1.0)
    return N


def rank_of(N: NDArray[np.float64]) -> int:
    """Return the rank of a matrix, whatever the units of its rows and columns are."""
    return _rank(tuple(map(tuple, N.tolist())))


@lru_cache(maxsize=16)
def _rank(N: tuple[tuple[float, ...], ...]) -> int:  # every start of a loop's controller asks for the same
    return int(np.linalg.matrix_rank(of_size_one(np.array(N))))


def pseudo_inverse(N: Matrix) -> Matrix:
    """Return the pseudo-inverse of N, (columns, rows).

    It is computed in whole numbers, and rounded once.

    A matrix of full rank has it exactly, and correctly rounded. Of one that is not, or is larger than `LARGEST`, it comes from
    LAPACK, rounded to 2^-30 of its largest entry: the same everywhere but where a tie lies between two machines.
    """
    rows, columns = N.shape
    full = max(rows, columns) <= LARGEST and rank_of(N) == min(rows, columns)
    found = _exact(tuple(map(tuple, N.tolist()))) if full else None
    if found is not None:
        return np.array(found)
    inverse = np.linalg.pinv(N)
    unit = math.ldexp(1.0, math.frexp(float(np.abs(inverse).max(initial=0.0)))[1] - 30)
    return np.asarray(np.rint(inverse / unit) * unit)


@lru_cache(maxsize=16)
def _exact(N: tuple[tuple[float, ...], ...]) -> list[list[float]] | None:
    # N = W / 2^bits. Of full row rank: N'(N N')^-1; of full column rank: (N'N)^-1 N'.
    bits = max(entry.as_integer_ratio()[1].bit_length() - 1 for row in N for entry in row)
    ratios = [[entry.as_integer_ratio() for entry in row] for row in N]
    W = [[(above << bits) // below for above, below in row] for row in ratios]
    T = [list(column) for column in zip(*W)]
    wide = len(W) <= len(T)
    solved = _solved(_product(W, T), W) if wide else _solved(_product(T, W), T)
    if solved is None:
        return None
    X, determinant = solved
    inverse = [list(column) for column in zip(*X)] if wide else X
    return [[(entry << bits) / determinant for entry in row] for row in inverse]


def _product(a: Whole, b: Whole) -> Whole:
    columns = list(zip(*b))
    return [[sum(x * y for x, y in zip(row, column)) for column in columns] for row in a]


def _solved(M: Whole, R: Whole) -> tuple[Whole, int] | None:
    """Solve M X = R without fractions: X times the determinant, and that; None where M is singular (Bareiss, 1968).

    M is a matrix times its transpose: unless it is singular, no pivot is zero.
    """
    n, work, before = len(M), [[*m, *r] for m, r in zip(M, R)], 1
    for k in range(n):
        own, lead = work[k], work[k][k]
        if not lead:
            return None
        for i, row in enumerate(work):
            if i != k:
                first = row[k]
                work[i] = [(lead * x - first * y) // before for x, y in zip(row, own)]
        before = lead
    return [row[n:] for row in work], before
