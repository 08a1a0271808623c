"""What a page's script draws and saves, as one JSON text: arrays, each stored once, figures, and columns of numbers for CSV."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.pages.html.figures import Bars, Histogram, Matrix, Scene

GAP = -32768
"""What stands for NaN among whole numbers."""


class Payload:
    """The arrays and figure descriptions that the page's script draws; equal arrays are stored once."""

    def __init__(self) -> None:
        self._arrays: list[dict[str, Any]] = []
        self._index: dict[bytes, int] = {}
        self.figures: list[dict[str, Any]] = []
        self._tables: list[list[dict[str, Any]]] = []

    def numbers(self, columns: Sequence[tuple[str, Sequence[Any]]]) -> int:
        """Store the numbers of a plot that the script does not draw, for whoever saves them, and return its number.

        Args:
            columns: heading and cells of each; floats that are not finite become empty.
        """
        told = [(name, [None if isinstance(c, float) and not math.isfinite(c) else c for c in cells]) for name, cells in columns]
        self._tables.append([{"name": name, "values": values} for name, values in told])
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
Column: TypeAlias = tuple[str, Sequence[Any]]


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
    edges = _plain(plot.edges)
    name = f"{plot.x_label or 'x'} ({plot.x_unit})" if plot.x_unit else plot.x_label or "x"
    return [(f"{name}, from", edges[:-1]), (f"{name}, to", edges[1:]), (plot.y_label or "count", _plain(plot.counts))]


def _bars(plot: Bars) -> list[Column]:
    unit = f" ({plot.y_unit})" if plot.y_unit else ""
    found: list[Column] = [(plot.x_label or "category", [str(category) for category in plot.categories])]
    for group in plot.groups:
        found.append((f"{group.label}{unit}", _plain(group.values)))
        if group.whiskers is not None:
            found += [(f"{group.label}, {end}{unit}", _plain(side)) for end, side in zip(("low", "high"), zip(*group.whiskers))]
    return found


def _matrix(plot: Matrix) -> list[Column]:
    found: list[Column] = [(plot.row_label or "row", [str(row) for row in plot.rows])]
    for j, name in enumerate(plot.columns):
        label = f"{plot.column_label} {name}".strip()
        found.append((label, _plain([row[j] for row in plot.values])))
        if plot.expected is not None:
            found.append((f"{label}, expected", _plain([row[j] for row in plot.expected])))
    return found


def _scene(plot: Scene) -> list[Column]:
    parts = [np.asarray(shape.points, dtype=np.float64).reshape(-1, 2) for shape in plot.shapes]
    points = np.vstack(parts).tolist()
    labels = [shape.label for shape, part in zip(plot.shapes, parts) for _ in range(len(part))]
    return [("shape", labels), (plot.x_label or "x", [float(f"{x:.7g}") for x, _ in points]),
            (plot.y_label or "y", [float(f"{y:.7g}") for _, y in points])]  # fmt: skip


def _plain(values: Any) -> list[Any]:
    """Return Python's numbers, which JSON keeps to the last digit; a None stays."""
    return [value.item() if isinstance(value, np.generic) else value for value in values]
