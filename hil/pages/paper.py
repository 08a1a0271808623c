"""The plots of a report as files for a paper: SVG and PDF, drawn by matplotlib, in millimetres."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict, replace

from hil.errors import HilError, located
from hil.files import made_folder, written_whole
from hil.measure.signals import with_unit
from hil.notebook import MM_PER_INCH, literal, paper_style
from hil.pages import Bars, Figure, Histogram, Matrix, Scene, Section, Shape
from hil.pages.html import share_text

Plot: TypeAlias = Figure | Bars | Histogram | Matrix | Scene

ENDINGS = (".svg", ".pdf")
GREY = 7
"""The colour number of what is no curve of its own: the reference."""


def write_figures(sections: Sequence[Section], folder: Path, *, width_mm: float = 85.0, height_mm: float = 55.0) -> list[Path]:
    """Write every plot of a report as SVG and PDF, and return the files.

    Args:
        sections: of the report; tables and words are left out.
        folder: made where it is missing; files of the same names are replaced.
        width_mm, height_mm: of each figure as it is printed; 85 mm is a column of many journals.

    Raises:
        HilError: if matplotlib is not installed, or the folder cannot be written.
    """
    context = paper_style("--figures")
    from matplotlib.figure import Figure as Sheet

    written: list[Path] = []
    plots = [block for section in sections for block in section.blocks if isinstance(block, Plot)]
    with located("--figures", HilError), context:
        made_folder(folder)
        for number, plot in enumerate(plots, start=1):
            sheet = Sheet(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH), layout="constrained")
            draw(plot, sheet.subplots())
            for ending in ENDINGS:
                path = folder / f"{number:02d}-{slug(plot.title)}{ending}"
                with written_whole(path, replace=True) as part:
                    sheet.savefig(part, metadata={"Date": None} if ending == ".svg" else {"CreationDate": None})
                written.append(path)
    return written


def slug(title: str) -> str:
    """Return a title as part of a file name.

    >>> slug("Delay (sensor → controller)")
    'delay-sensor-controller'
    """
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:60] or "figure"


def draw(plot: Plot, axis: Any) -> None:
    """Draw one plot of a report, its texts `literal`.

    Args:
        plot: the plot.
        axis: of matplotlib.
    """
    plot = _literal(plot)
    if isinstance(plot, Figure):
        _curves(plot, axis)
    elif isinstance(plot, Bars):
        _bars(plot, axis)
    elif isinstance(plot, Matrix):
        _heat_map(plot, axis)
    elif isinstance(plot, Scene):
        _map(plot, axis)
    else:
        edges, counts = np.asarray(plot.edges), np.asarray(plot.counts)
        axis.stairs(counts, edges, fill=True, color=_colour(plot.colour, 0))
        _scale("x", axis, plot.x_log)
        _scale("y", axis, plot.y_log)
        axis.set_xlabel(with_unit(plot.x_label, plot.x_unit))
        axis.set_ylabel(plot.y_label)
        _marks(axis, plot.markers)


def _literal(value: Any) -> Any:
    """Return a plot, or a part of it, whose texts matplotlib draws as they are."""
    if isinstance(value, str):
        return literal(value)
    if isinstance(value, tuple | list):
        return type(value)(map(_literal, value))
    if isinstance(value, Struct):
        return replace(value, **{name: _literal(part) for name, part in asdict(value).items()})
    return value


def _curves(plot: Figure, axis: Any) -> None:
    for number, band in enumerate(plot.bands):
        colour = _colour(band.colour, number)
        axis.fill_between(band.x, band.lower, band.upper, color=colour, alpha=0.25, linewidth=0, label=band.label)
    for number, series in enumerate(plot.series):
        style: dict[str, Any] = {"color": _colour(series.colour, number), "label": series.label}
        style["alpha"] = 0.4 if series.faint else 1.0
        if series.style == "points":
            axis.plot(series.x, series.y, linestyle="none", marker=".", markersize=2, **style)
        elif series.style == "circles":
            axis.plot(series.x, series.y, linestyle="none", marker="o", markersize=4, markerfacecolor="none", **style)
        else:
            axis.plot(
                series.x, series.y, "--" if series.style.startswith("dashed") else "-",
                drawstyle="steps-post" if series.style.endswith("step") else "default",
                linewidth=2.5 if series.halo else 1.0, marker="o" if series.marked else "", markersize=3, **style,
            )  # fmt: skip
    _scale("x", axis, plot.x_log, plot.x_asinh)
    _scale("y", axis, plot.y_log, plot.y_asinh)
    if plot.x_ticks:
        axis.set_xticks(plot.x_ticks)
    if plot.y_names:
        axis.set_yticks(range(len(plot.y_names)), plot.y_names)
    elif plot.integer_y and axis.get_yscale() == "linear":
        axis.locator_params(axis="y", integer=True)
    if plot.y_range is not None:
        axis.set_ylim(*plot.y_range)
    axis.set_xlabel(with_unit(plot.x_label, plot.x_unit))
    axis.set_ylabel(with_unit(plot.y_label, plot.y_unit))
    _marks(axis, plot.markers)
    if len(plot.series) + len(plot.bands) > 1:
        axis.legend()


def _bars(plot: Bars, axis: Any) -> None:
    x, width = np.arange(len(plot.categories)), 0.8 / max(len(plot.groups), 1)
    for number, group in enumerate(plot.groups):
        at = x + (number - (len(plot.groups) - 1) / 2) * width
        colour = _colour(group.colour, number)
        face = "none" if group.hollow else colour
        spread = None if group.whiskers is None else np.abs(np.transpose(group.whiskers) - np.asarray(group.values))
        axis.bar(at, group.values, width, yerr=spread, label=group.label, edgecolor=colour, facecolor=face)
    axis.set_xticks(x, plot.categories)
    axis.set_xlabel(plot.x_label)
    axis.set_ylabel(with_unit(plot.y_label, plot.y_unit))
    if len(plot.groups) > 1:
        axis.legend()


def _heat_map(plot: Matrix, axis: Any) -> None:
    values = np.array([[np.nan if value is None else value for value in row] for row in plot.values], dtype=np.float64)
    axis.imshow(values, cmap="Blues", vmin=plot.low, vmax=plot.low + 1.6 * ((plot.high - plot.low) or 1.0), aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        expected = None if plot.expected is None else plot.expected[i][j]
        below = "" if expected is None else f"\n({share_text(expected)})"
        axis.text(j, i, f"{share_text(float(value))}{below}", ha="center", va="center")
    axis.set_xticks(range(len(plot.columns)), [str(name) for name in plot.columns])
    axis.set_yticks(range(len(plot.rows)), [str(name) for name in plot.rows])
    axis.set_xlabel(plot.column_label)
    axis.set_ylabel(plot.row_label)


def _map(plot: Scene, axis: Any) -> None:
    labels: set[str] = set()
    for shape in plot.shapes:
        points = np.asarray(shape.points, dtype=np.float64)
        style: dict[str, Any] = {"color": _ink(shape), "linewidth": 0.5 if shape.faint else 1.0}
        style["label"] = shape.label if shape.label not in labels else None
        if shape.filled:
            axis.fill(points[:, 0], points[:, 1], **{**style, "alpha": 0.3, "linewidth": 0.0})
        else:
            axis.plot(points[:, 0], points[:, 1], alpha=0.5 if shape.faint else 1.0, **style)
        labels.add(shape.label)
    for x, y, words in plot.labels:
        axis.text(x, y, words)
    axis.set_aspect("equal", adjustable="datalim")
    if not plot.axes:
        axis.set_axis_off()
    axis.set_xlabel(plot.x_label)
    axis.set_ylabel(plot.y_label)
    if labels - {""}:
        axis.legend()


def _ink(shape: Shape) -> str:
    return "black" if shape.colour is None else _colour(shape.colour, 0)


def _scale(side: str, axis: Any, log: bool, asinh: float | None = None) -> None:
    scale = axis.set_xscale if side == "x" else axis.set_yscale
    scale("asinh", linear_width=asinh) if asinh else scale("log" if log else "linear")


def _marks(axis: Any, markers: Sequence[Any]) -> None:
    for marker in markers:
        axis.axvline(marker.x, color="0.6", linewidth=0.5, zorder=0)


def _colour(number: int | None, otherwise: int) -> str:
    chosen = otherwise if number is None else number
    return "0.45" if chosen == GREY else f"C{chosen}"


