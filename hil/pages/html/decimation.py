"""Fewer points, same picture: minimum and maximum of every bucket, and run ends of a step curve."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Float: TypeAlias = npt.NDArray[np.float64]
Index: TypeAlias = npt.NDArray[np.intp]
Blocks: TypeAlias = Callable[[], Iterator[tuple[Float, Float]]]

WHOLE = 25_000
"""Curves of up to so many points are kept as they are (20 s at 1 kHz), so that zooming shows every sample."""

BUCKETS = 4000
"""Intervals of x that a longer curve is reduced to: several per pixel of a wide window, so that zooming still helps."""


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
    if x.size > 4 * buckets and 0.0 < (span := float(x[-1] - x[0])) < np.inf:
        return _extremes(x, y, buckets, float(x[0]), span)
    return np.arange(x.size, dtype=np.intp)


def _extremes(x: Float, y: Float, buckets: int, begin: float, span: float) -> Index:
    bucket = np.minimum(((x - begin) * (buckets / span)).astype(np.intp), buckets - 1)
    starts = np.flatnonzero(np.diff(bucket, prepend=-1))
    ends = np.append(starts[1:], x.size) - 1
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


def reduced(blocks: Blocks, *, step: bool, whole: int = WHOLE, buckets: int = BUCKETS) -> tuple[Float, Float, int]:
    """Return what a page keeps of a curve that is read block by block, and how many samples it had.

    The same points as `bucket_extremes` would keep of the curve in one piece: of every block those that may be kept are picked
    first, and what is picked is reduced once more. A held curve needs no more than where it changes, and its last sample.

    Args:
        blocks: gives x and y of one block after the other, from the begin each time it is called; x does not decrease.
        step: the curve holds its value until the next x.
        whole: a curve of up to so many points is kept as it is.
        buckets: that a longer one is reduced to.

    >>> held = np.array([0.0, 0.0, 1.0, 1.0, 1.0])
    >>> reduced(lambda: iter([(np.arange(5.0), held)]), step=True)
    (array([0., 2., 4.]), array([0., 1., 1.]), 5)
    """
    samples, first, last = 0, 0.0, 0.0
    for x, _ in blocks():
        if x.size:
            first, last = float(x[0]) if not samples else first, float(x[-1])
            samples += x.size
    span, points = last - first, 0
    whole = whole if 0.0 < span < np.inf else samples
    kept: list[tuple[Float, Float]] = []
    picked: list[tuple[Float, Float]] = []
    for x, y in _ends(blocks(), samples) if step else blocks():
        finite = np.where(np.isfinite(y), y, np.nan)
        points += x.size
        if points <= whole:
            kept.append((x, finite))
        if x.size and samples > whole:
            some = _extremes(x, finite, buckets, first, span)
            gap = np.isnan(finite)
            before = np.flatnonzero(gap[1:] & ~gap[:-1])  # without it a gap behind a gap would not begin
            some = np.union1d(some, before)
            picked.append((x[some], finite[some]))
    if points <= whole:
        return *_joined(kept), samples
    x, y = _joined(picked)
    last_cut = _extremes(x, y, buckets, first, span)
    return x[last_cut], y[last_cut], samples


def _ends(blocks: Iterator[tuple[Float, Float]], samples: int) -> Iterator[tuple[Float, Float]]:
    """Give of every block the samples at which the held value changes, and the last one of all."""
    before, seen = np.empty(0), 0
    for x, y in blocks:
        y = np.where(np.isfinite(y), y, np.nan)
        both = np.concatenate((before, y))
        changed = np.ones(both.size, dtype=np.bool_)
        changed[1:] = ~((both[1:] == both[:-1]) | (np.isnan(both[1:]) & np.isnan(both[:-1])))  # a gap is a value
        own, seen = changed[before.size :], seen + x.size
        if seen == samples and own.size:
            own[-1] = True
        yield x[own], y[own]
        before = both[-1:]


def _joined(parts: list[tuple[Float, Float]]) -> tuple[Float, Float]:
    none = np.empty(0)
    return np.concatenate([none, *(x for x, _ in parts)]), np.concatenate([none, *(y for _, y in parts)])
