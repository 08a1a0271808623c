"""Several experiments under common random numbers: distributions of their metrics, and paired differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.measure.units import metric_units
from hil.report.html.figures import Block, Figure, Section, Series, Table
from hil.report.html.page import render_page

TITLES = {
    "sse": "squared tracking error",
    "sse_after_5s": "squared tracking error after 5 s",
    "overshoot": "overshoot",
    "settling_time_s": "settling time",
    "steady_state_error": "steady-state error",
    "max_abs_u": "largest input",
}


def paired(a: NDArray[np.float64], b: NDArray[np.float64]) -> dict[str, Any]:
    """Return mean difference b - a over the seeds that both have, and its 95 % interval (normal, paired)."""
    both = np.isfinite(a) & np.isfinite(b)
    gap = (b - a)[both]
    if gap.size < 2:
        return {"n": int(gap.size), "mean": None, "low": None, "high": None}
    half = 1.96 * float(gap.std(ddof=1)) / float(np.sqrt(gap.size))
    mean = float(gap.mean())
    return {"n": int(gap.size), "mean": mean, "low": mean - half, "high": mean + half}


def compare_page(found: Mapping[str, Mapping[str, NDArray[np.float64]]], runs: int, plants: Sequence[Any] = ()) -> str:
    """Return the page: empirical distribution functions per metric, one curve per experiment, and the table.

    Args:
        found: mapping of experiment to metrics. What :func:`hil.sweeps.seeds.sweep` gives, per experiment, over the same seeds.
        runs: number of seeds.
        plants: of the experiments: they state the units. A metric whose unit differs between them, or is not known, has none.
    """
    names = list(found)
    tracked = [s.unit for plant in plants for s in plant.outputs if s.name in getattr(plant, "tracked", (s.name,))]
    units = metric_units(tracked, [s.unit for plant in plants for s in plant.inputs])
    sections = []
    for metric, title in TITLES.items():
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
                x_unit=units[metric],
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
