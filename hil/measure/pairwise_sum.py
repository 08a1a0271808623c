"""The sum of a column that is never whole in memory, bit for bit what numpy's sum of it would be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

LEAF: Final = 1 << 15
"""Entries that are summed at once; numpy itself goes on halving down to 128."""


def pairwise_sum(of: Callable[[int, int], npt.NDArray[np.floating[Any]]], n: int, begin: int = 0) -> float:
    """Return the sum of n numbers by halves: s(n) = s(m) + s(n - m), m = n/2 less n/2 mod 8, as `numpy.sum` adds a column.

    Args:
        of: returns the entries from i to j - 1.
        n: how many there are.
        begin: the first of them.

    Reference: N. J. Higham, The accuracy of floating point summation, SIAM J. Sci. Comput. 14 (1993), section 2.

    >>> column = np.arange(100_000) / 7.0
    >>> pairwise_sum(lambda i, j: column[i:j], len(column)) == np.sum(column)
    np.True_
    """
    if n <= LEAF:
        return float(np.sum(of(begin, begin + n)))
    half = n // 2
    half -= half % 8
    return pairwise_sum(of, half, begin) + pairwise_sum(of, n - half, begin + half)
