"""Products that are summed in one order, so that their bits are the same on every machine: no BLAS, nothing fused."""

from __future__ import annotations

from collections.abc import Sequence

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
