"""The page of a sweep over parameters: heat maps over two keys, lines with intervals over one, and all points in a table."""

from __future__ import annotations

from typing import Any

import numpy as np

from design.monte_carlo.confidence import Interval
from hil.measure.measure import Quantity
from hil.measure.signals import with_unit
from hil.pages.html.figures import Band, BarGroup, Bars, Block, Figure, Matrix, Section, Series, Table
from hil.pages.html.page import render_page
from hil.sweeps.parameters import ParameterSweep
from hil.sweeps.points import numbers_of
from hil.sweeps.shown import interval_of


def parameter_page(sweep: ParameterSweep) -> str:
    """Return the page.

    Args:
        sweep: what was found.
    """
    runs = max((columns["seed"].size for columns in sweep.columns), default=0)
    sections = []
    for quantity in sweep.quantities:
        found = [interval_of(columns[quantity.name]) for columns in sweep.columns]
        if any(np.isfinite(i.value) for i in found):
            blocks = (*_pictures(sweep, quantity, found), _table(sweep, quantity, found))
            sections.append(Section(title=quantity.title, blocks=blocks))
    stopped = sum(int(columns["stopped"].sum()) for columns in sweep.columns)
    facts = (
        ("points", str(len(sweep.columns))), ("runs of each", str(runs)), ("stopped by safety", str(stopped)),
        ("seeds", "the same at every point: equal network laws meet equal delays"),
    )  # fmt: skip
    title = f"{sweep.experiment} over {', '.join(sweep.points.keys)}"
    return render_page(title, sections, subtitle="sweep over parameters", facts=facts)


def _pictures(sweep: ParameterSweep, quantity: Quantity, found: list[Interval]) -> list[Block]:
    points = sweep.points
    complete = len(found) == len(points.values)
    if len(points.axes) == 1 and complete:
        return [_lines(points.keys[0], points.axes[0], {"": found}, quantity)]
    if len(points.axes) == 2 and complete:
        rows, columns = points.axes
        means = np.array([i.value for i in found]).reshape(len(rows), len(columns))
        finite = means[np.isfinite(means)]
        chart = Matrix(
            title=f"{with_unit(quantity.title, quantity.unit)}: mean", rows=rows, columns=columns, row_label=points.keys[0],
            column_label=points.keys[1], values=[[v if np.isfinite(v) else None for v in row] for row in means.tolist()],
            low=float(finite.min()), high=float(finite.max()), note="the darker, the larger",
        )  # fmt: skip
        groups = {f"{points.keys[0]} {row}": found[i * len(columns) : (i + 1) * len(columns)] for i, row in enumerate(rows)}
        return [chart, _lines(points.keys[1], columns, groups, quantity)]
    return []


def _lines(key: str, axis: tuple[str, ...], groups: dict[str, list[Interval]], quantity: Quantity) -> Block:
    x, unit = numbers_of(axis)
    label = with_unit(quantity.title, quantity.unit)
    if x is None or len(axis) < 2:
        bars = tuple(
            BarGroup(label=name or quantity.title, values=[i.value for i in line], errors=[_half(i) for i in line], colour=c)
            for c, (name, line) in enumerate(groups.items())
        )
        return Bars(title=f"{label}: mean, 95 % interval", categories=axis, groups=bars, x_label=key, y_label=label)
    order = np.argsort(x)
    series, bands = [], []
    for colour, (name, line) in enumerate(groups.items()):
        mean, low, high = (np.array(side)[order] for side in zip(*((i.value, *_ends(i)) for i in line)))
        series.append(Series(label=name or "mean", x=x[order], y=mean, colour=colour))
        bands.append(Band(label="95 % interval", x=x[order], lower=low, upper=high, colour=colour))
    return Figure(
        title=f"{label}: mean, 95 % interval", series=tuple(series), bands=tuple(bands), x_label=key, x_unit=unit,
        y_label=quantity.title, y_unit=quantity.unit, sync=None,
    )  # fmt: skip


def _ends(interval: Interval) -> tuple[float, float]:
    """The interval, the value alone where it is infinitely wide."""
    return (interval.low, interval.high) if np.isfinite(interval.half_width) else (interval.value, interval.value)


def _half(interval: Interval) -> float:
    return interval.half_width if np.isfinite(interval.half_width) else 0.0


def _table(sweep: ParameterSweep, quantity: Quantity, found: list[Interval]) -> Block:
    rows: list[list[Any]] = []
    for number, i in enumerate(found):
        defined = np.isfinite(i.value)
        inner = f"{i.low:.4g} to {i.high:.4g}" if np.isfinite(i.half_width) else "-"
        rows.append([*sweep.points.values[number], i.n, i.value if defined else None, inner])
    columns = (*sweep.points.keys, "runs", with_unit("mean", quantity.unit), "95 % interval")
    return Table(columns=columns, rows=rows)
