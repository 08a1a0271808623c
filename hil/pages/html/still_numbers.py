"""The numbers of bars, histograms, heat maps and maps as columns, as a page saves them in CSV."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from hil.pages.html.figures import Bars, Histogram, Matrix, Scene

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
        if group.errors is not None:
            found.append((f"{group.label}, +-{unit}", _plain(group.errors)))
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
