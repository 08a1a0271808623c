"""Fewer points, same picture: minimum and maximum of every bucket, and run ends of a step curve."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Float: TypeAlias = npt.NDArray[np.float64]
Index: TypeAlias = npt.NDArray[np.intp]


def bucket_extremes(x: Float, y: Float, buckets: int) -> Index:
    """Return the indices to keep so that the curve keeps its envelope in each of `buckets` equal intervals of x.

    In every interval the first, the last, the smallest and the largest sample stay, so a spike one sample long
    survives; a NaN (a gap) stays as well.

    Args:
        x: shape (n,), not decreasing.
        y: shape (n,).
        buckets: at least 1.

    Returns:
        Increasing indices, at most about 5 per bucket; all of them where that is no saving.

    >>> y = np.zeros(1000); y[437] = 1.0
    >>> 437 in bucket_extremes(np.arange(1000.0), y, 10)
    True
    """
    n = x.size
    if n <= 4 * buckets or n < 3:
        return np.arange(n, dtype=np.intp)
    span = x[-1] - x[0]
    if not span > 0.0 or not np.isfinite(span):
        return np.arange(n, dtype=np.intp)
    bucket = np.minimum(((x - x[0]) * (buckets / span)).astype(np.intp), buckets - 1)
    starts = np.flatnonzero(np.diff(bucket, prepend=-1))
    ends = np.append(starts[1:], n) - 1
    lowest = _argument_per_run(np.where(np.isnan(y), np.inf, y), starts, np.minimum)
    highest = _argument_per_run(np.where(np.isnan(y), -np.inf, y), starts, np.maximum)
    gap = np.isnan(y)
    first_of_gap = np.flatnonzero(gap & ~np.concatenate(([False], gap[:-1])))
    return np.unique(np.concatenate((starts, ends, lowest, highest, first_of_gap))).astype(np.intp)


def _argument_per_run(y: Float, starts: Index, extreme: Any) -> Index:
    """Return the index of the first extreme value of each run of y that begins at `starts`."""
    best = extreme.reduceat(y, starts)
    run = np.repeat(np.arange(starts.size), np.diff(np.append(starts, y.size)))
    hits = np.flatnonzero(y == best[run])
    _, first = np.unique(run[hits], return_index=True)
    return hits[first].astype(np.intp)


def step_ends(y: Float) -> Index:
    """Return the indices at which a held curve changes, and its last one: a step curve needs no more.

    >>> step_ends(np.array([0.0, 0.0, 1.0, 1.0, 1.0]))
    array([0, 2, 4])
    """
    if y.size == 0:
        return np.arange(0, dtype=np.intp)
    changed = np.ones(y.size, dtype=bool)
    same = (y[1:] == y[:-1]) | (np.isnan(y[1:]) & np.isnan(y[:-1]))
    changed[1:] = ~same
    changed[-1] = True
    return np.flatnonzero(changed).astype(np.intp)
