"""What a page's script draws and saves, as one JSON text: arrays, each stored once, figures, and columns of numbers for CSV.

A long curve is reduced to fewer points of the same picture: minimum and maximum of every bucket, and run ends of a step curve.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.measure.signals import with_unit
from hil.pages import Bars, Histogram, Matrix, Scene

GAP = -32768
"""What stands for NaN among whole numbers."""


class Payload:
    """The arrays and figure descriptions that the page's script draws; equal arrays are stored once."""

    def __init__(self) -> None:
        self._arrays: list[dict[str, Any]] = []
        self._index: dict[bytes, int] = {}
        self.figures: list[dict[str, Any]] = []
        self._tables: list[list[dict[str, Any]]] = []

    def numbers(self, columns: Sequence[tuple[str, Iterable[Any]]]) -> int:
        """Store the numbers of a plot that the script does not draw but a user may save, and return its number.

        Args:
            columns: heading and cells of each; floats that are not finite become empty.
        """
        self._tables.append([{"name": name, "values": [_plain(cell) for cell in cells]} for name, cells in columns])
        return len(self._tables) - 1

    def add(self, values: npt.NDArray[np.float64]) -> int:
        """Store an array and return its number: int16 for small whole numbers, float32 where that is exact enough."""
        whole = np.where(np.isnan(values), GAP, values)
        if np.all(np.abs(whole) <= -GAP) and np.array_equal(whole, np.round(whole)):
            return self._store("i2", whole.astype("<i2").tobytes())
        finite = values[np.isfinite(values)]
        largest = float(np.abs(finite).max(initial=0.0))
        if largest > float(np.finfo(np.float32).max):
            return self._store("f8", values.astype("<f8").tobytes())
        narrow = values.astype("<f4")
        steps = np.abs(np.diff(finite))
        steps = steps[steps > 0]
        rounding = largest * 6e-8
        # y needs no more than a ten-thousandth of what is drawn; x needs its samples kept apart. One test serves both.
        enough = steps.size == 0 or rounding < max(0.05 * float(steps.min()), 1e-5 * float(np.ptp(finite)))
        return self._store("f4", narrow.tobytes()) if enough else self._store("f8", values.astype("<f8").tobytes())

    def _store(self, kind: str, data: bytes) -> int:
        key = kind.encode() + data
        if key not in self._index:
            self._index[key] = len(self._arrays)
            self._arrays.append({"t": kind, "d": base64.b64encode(data).decode("ascii")})
        return self._index[key]

    def json(self) -> str:
        """Return the JSON for a script element: no `<`, so nothing in it can end the element."""
        content = {"arrays": self._arrays, "figures": self.figures, "tables": self._tables}
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


Still: TypeAlias = Bars | Histogram | Matrix | Scene
Column: TypeAlias = tuple[str, Iterable[Any]]


def columns_of(plot: Still) -> list[Column]:
    """Return heading and cells of each column.

    Args:
        plot: what is drawn once and cannot be zoomed.

    >>> columns_of(Histogram(title="lateness", edges=[0.0, 1.5, 3.0], counts=[7, 2], x_label="lateness", x_unit="us"))
    [('lateness (us), from', [0.0, 1.5]), ('lateness (us), to', [1.5, 3.0]), ('count', [7, 2])]
    """
    if isinstance(plot, Histogram):
        return _histogram(plot)
    if isinstance(plot, Bars):
        return _bars(plot)
    return _matrix(plot) if isinstance(plot, Matrix) else _scene(plot)


def _histogram(plot: Histogram) -> list[Column]:
    edges, name = plot.edges, with_unit(plot.x_label or "x", plot.x_unit)
    return [(f"{name}, from", edges[:-1]), (f"{name}, to", edges[1:]), (plot.y_label or "count", plot.counts)]


def _bars(plot: Bars) -> list[Column]:
    found: list[Column] = [(plot.x_label or "category", [str(category) for category in plot.categories])]
    for group in plot.groups:
        ends = () if group.whiskers is None else zip((f"{group.label}, low", f"{group.label}, high"), zip(*group.whiskers))
        found += [(with_unit(name, plot.y_unit), side) for name, side in ((group.label, group.values), *ends)]
    return found


def _matrix(plot: Matrix) -> list[Column]:
    found: list[Column] = [(plot.row_label or "row", [str(row) for row in plot.rows])]
    for j, name in enumerate(plot.columns):
        label = f"{plot.column_label} {name}".strip()
        found.append((label, [row[j] for row in plot.values]))
        if plot.expected is not None:
            found.append((f"{label}, expected", [row[j] for row in plot.expected]))
    return found


def _scene(plot: Scene) -> list[Column]:
    parts = [np.asarray(shape.points, dtype=np.float64).reshape(-1, 2) for shape in plot.shapes]
    points = np.vstack(parts).tolist()
    labels = [shape.label for shape, part in zip(plot.shapes, parts) for _ in range(len(part))]
    return [("shape", labels), (plot.x_label or "x", [float(f"{x:.7g}") for x, _ in points]),
            (plot.y_label or "y", [float(f"{y:.7g}") for _, y in points])]  # fmt: skip


def _plain(cell: Any) -> Any:
    """Return a number of Python, which JSON keeps to the last digit, None where it is not finite; anything else as it is."""
    value = cell.item() if isinstance(cell, np.generic) else cell
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
