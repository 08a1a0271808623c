"""Several experiments under common random numbers: distributions of their metrics, and paired differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.measure.measure import Quantity
from hil.report.html.figures import Block, Figure, Section, Series, Table
from hil.report.html.page import render_page


def paired(a: NDArray[np.float64], b: NDArray[np.float64]) -> dict[str, Any]:
    """Return mean difference b - a over the seeds that both have, and its 95 % interval (normal, paired)."""
    both = np.isfinite(a) & np.isfinite(b)
    gap = (b - a)[both]
    if gap.size < 2:
        return {"n": int(gap.size), "mean": None, "low": None, "high": None}
    half = 1.96 * float(gap.std(ddof=1)) / float(np.sqrt(gap.size))
    mean = float(gap.mean())
    return {"n": int(gap.size), "mean": mean, "low": mean - half, "high": mean + half}


def common_quantities(several: Sequence[Sequence[Quantity]]) -> tuple[Quantity, ...]:
    """Return the quantities that all of several experiments have; one whose unit differs between them has none."""
    first, *others = ({q.name: q for q in quantities} for quantities in several)
    return tuple(
        q if all(other[name].unit == q.unit for other in others) else replace(q, unit="")
        for name, q in first.items()
        if all(name in other for other in others)
    )


def compare_page(found: Mapping[str, Mapping[str, NDArray[np.float64]]], runs: int, quantities: Sequence[Quantity]) -> str:
    """Return the page: empirical distribution functions per metric, one curve per experiment, and the table.

    Args:
        found: mapping of experiment to metrics. What :func:`hil.sweeps.seeds.sweep` gives, per experiment, over the same seeds.
        runs: number of seeds.
        quantities: what is compared, with titles and units; see `common_quantities`.
    """
    names = list(found)
    sections = []
    for quantity in quantities:
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
            gap = paired(found[names[0]][metric], values)
            rows.append([
                name, int(finite.size), *([float(finite.mean()), float(finite.std(ddof=1)) if finite.size > 1 else 0.0,
                *map(float, np.percentile(finite, (5, 50, 95)))] if finite.size else [None] * 5),
                None if name == names[0] else gap["mean"],
                "-" if name == names[0] or gap["mean"] is None else f"{gap['low']:.4g} to {gap['high']:.4g}",
            ])  # fmt: skip
        blocks: tuple[Block, ...] = (
            Figure(
                title=f"{title}: share of runs at or below",
                series=tuple(series),
                x_label=title,
                x_unit=f"share of {quantity.share_of}" if quantity.share_of else quantity.unit,
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
    stopped = ", ".join(f"{name}: {int(found[name]['stopped'].sum())}" for name in names)
    return render_page(
        "Comparison of experiments",
        sections,
        subtitle=", ".join(names),
        facts=(("runs of each", str(runs)), ("stopped by safety", stopped)),
    )
