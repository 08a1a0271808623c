"""The page of a comparison: distributions of every quantity, and paired differences."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.monte_carlo.confidence import Interval
from hil.measure.signals import with_unit
from hil.pages.html.figures import Block, Figure, Section, Series, Table, Text
from hil.pages.html.page import render_page
from hil.sweeps.comparison import Comparison

CRUSHED = 20.0
"""Largest value above the smallest median from which a linear axis shows no difference of the smaller ones."""


def compare_page(comparison: Comparison) -> str:
    """Return the page: empirical distribution functions per metric, one curve per experiment, and the table.
    """
    found, names = comparison.values, list(comparison.values)
    sections = []
    for quantity in comparison.quantities:
        metric, title = quantity.name, quantity.title
        series = []
        for i, name in enumerate(names):
            values = np.sort(found[name][metric][np.isfinite(found[name][metric])])
            if values.size:
                share = np.arange(1, values.size + 1) / values.size
                series.append(Series(label=name, x=values, y=share, style="step", colour=i))
        if not series:
            continue
        rows: list[list[Any]] = []
        for name in names:
            values = found[name][metric]
            finite = values[np.isfinite(values)]
            gap = comparison.difference(name, metric)
            rows.append([
                name, int(finite.size), *([float(finite.mean()), float(finite.std(ddof=1)) if finite.size > 1 else 0.0,
                *map(float, np.percentile(finite, (5, 50, 95)))] if finite.size else [None] * 5),
                *_difference(gap, name == names[0]),
            ])  # fmt: skip
        blocks: tuple[Block, ...] = (
            Figure(
                title=f"{title}: share of runs at or below",
                series=tuple(series),
                x_label=title,
                x_unit=quantity.unit,
                x_log=_crushed([found[name][metric] for name in names]),
                y_label="share",
                y_range=(0.0, 1.0),
                sync=None,
            ),
            Table(
                columns=("experiment", "runs", "mean", "sd", "5 %", "50 %", "95 %", "difference", "95 % interval"),
                rows=rows,
                note=f"differences are against {names[0]}, run by run on the same delays",
            ),
        )
        sections.append(Section(title=title, blocks=blocks))
    sections.insert(0, _answer(comparison))
    stopped = ", ".join(f"{name}: {int(found[name]['stopped'].sum())}" for name in names)
    return render_page(
        "Comparison of experiments",
        sections,
        subtitle=", ".join(names),
        facts=(("runs of each", str(comparison.runs)), ("stopped by safety", stopped)),
    )


def _crushed(samples: list[NDArray[np.float64]]) -> bool:
    """Return whether one experiment would press the others onto the edge of a linear axis, and a logarithm can show all."""
    finite = [values[np.isfinite(values)] for values in samples]
    known = [values for values in finite if values.size]
    if not known or min(float(values.min()) for values in known) <= 0.0:
        return False
    return max(float(values.max()) for values in known) > CRUSHED * min(float(np.median(values)) for values in known)


def _answer(comparison: Comparison) -> Section:
    """The verdicts in words, and one table of all quantities: how many runs have it, mean, difference, interval."""
    rows: list[list[Any]] = []
    for quantity in comparison.quantities:
        for name in comparison.values:
            values = comparison.values[name][quantity.name]
            finite = values[np.isfinite(values)]
            gap = comparison.difference(name, quantity.name)
            rows.append([
                with_unit(quantity.title, quantity.unit), name, int(finite.size), float(finite.mean()) if finite.size else None,
                *_difference(gap, name == comparison.first),
            ])  # fmt: skip
    verdicts = tuple(Text(text=comparison.verdict(name)) for name in list(comparison.values)[1:])
    table = Table(
        columns=("metric", "experiment", "runs", "mean", "difference", "95 % interval"), rows=rows,
        note=f"Differences are against {comparison.first}, run by run on the same delays. Runs: those that have the number.",
    )  # fmt: skip
    cautions = tuple(Text(text=f"{name}: {caution}") for name, caution in comparison.cautions.items())
    return Section(title="Answer", blocks=(*verdicts, *cautions, table))


def _difference(gap: Interval, first: bool) -> tuple[float | None, str]:
    if first or not np.isfinite(gap.half_width):
        return None, "-"
    return gap.value, f"{gap.low:.4g} to {gap.high:.4g}"
