"""Pages of many runs: of one experiment, a comparison of experiments, a sweep over parameters."""

from __future__ import annotations

from typing import Any

import numpy as np

from design.monte_carlo.confidence import Interval
from hil.measure import Quantity
from hil.measure.signals import with_unit
from hil.pages import Band, BarGroup, Bars, Block, Figure, Matrix, Section, Series, Table, Text
from hil.pages.html import capital
from hil.pages.html.page import Page
from hil.sweeps import Sweep, statistics
from hil.sweeps.comparison import Comparison
from hil.sweeps.parameters import ParameterSweep
from hil.sweeps.points import numbers_of
from hil.sweeps.shown import SHORTER, axis_for, distributions, ends_of, within

DIFFERENCE = ("difference", "95 % interval")


def compare_page(comparison: Comparison) -> str:
    """Return the page: empirical distribution functions per metric, one curve per experiment, and the table.

    It shows the paired differences, too, where there are several.
    """
    found, names = comparison.values, list(comparison.values)
    several = len(names) > 1
    sections = []
    for quantity in comparison.quantities:
        metric, title = quantity.name, quantity.title
        curves = distributions({name: columns[metric] for name, columns in found.items()})
        series = [Series(label=name, x=x, y=y, style="step", colour=names.index(name)) for name, (x, y) in curves.items()]
        if not series:
            continue
        axis = axis_for([found[name][metric] for name in names])
        rows: list[list[Any]] = []
        for name in names:
            s, gap = statistics(found[name][metric]), comparison.difference(name, metric)
            percentiles = (s["percentiles"].get(p) for p in ("5", "50", "95"))
            gap_cells = (None, None) if name == names[0] or gap.n < 2 else (gap.value, _in_one_line(within(gap)))
            rows.append([name, s["n"], s["mean"], s["sd"], *percentiles, *gap_cells])
        blocks: tuple[Block, ...] = (
            Figure(
                title=capital(f"{title}: share of runs at or below"),
                series=tuple(series),
                x_label=title,
                x_unit=quantity.unit,
                x_log=axis.log,
                x_asinh=axis.asinh,
                note=axis.note,
                y_label="share",
                y_range=(0.0, 1.0),
                sync=None,
            ),
            Table(
                columns=("experiment", "runs", "mean", "sd", "5 %", "50 %", "95 %", *DIFFERENCE[: 2 * several]),
                rows=[row[: 7 + 2 * several] for row in rows],
                note=f"Differences are against {names[0]}, run by run on the same delays" if several else "",
            ),
        )
        sections.append(Section(title=capital(title), blocks=blocks))
    sections.insert(0, _answer(comparison))
    stopped = ", ".join(f"{name}: " * several + str(int(found[name]["stopped"].sum())) for name in names)
    return Page(
        "Comparison of experiments" if several else names[0],
        sections,
        subtitle=", ".join(names) if several else "Many runs",
        facts=(("runs of each" if several else "runs", str(comparison.runs)), ("stopped by safety", stopped)),
    ).html()


def sweep_page(sweep: Sweep) -> str:
    """Return the page of many runs of one experiment: the numbers, and the distribution of each."""
    name, said, runs = sweep.experiment, sweep.caution, int(sweep.values["seed"].size)
    cautions = {name: said} if said else {}
    return compare_page(Comparison(runs=runs, values={name: sweep.values}, quantities=sweep.quantities, cautions=cautions))


def _answer(comparison: Comparison) -> Section:
    """The verdicts in words, and one table of the quantities: how many runs have it, mean, difference, interval."""
    verdicts = tuple(Text(text=comparison.verdict(name)) for name in list(comparison.values)[1:])
    none = comparison.measured()[1]
    several = len(comparison.values) > 1
    table = Table(
        columns=("metric", "experiment", "runs", "mean", *DIFFERENCE[: 2 * several]),
        rows=[[*row[:-1], _in_one_line(row[-1])][: 4 + 2 * several] for row in comparison.rows()],
        note=f"Differences are against {comparison.first}, run by run on the same delays. " * several
        + "Runs: those that have the number."
        + "".join(f" {capital(each)}." for each in (none, SHORTER if comparison.stopped else "") if each),
    )  # fmt: skip
    cautions = tuple(Text(text=f"{name}: {caution}") for name, caution in comparison.cautions.items())
    return Section(title="Answer", blocks=(*verdicts, *cautions, table))


def _in_one_line(text: str | None) -> str | None:
    """An interval as a page writes numbers, whose blanks do not break, on a phone either."""
    return text and text.replace(" ", "\N{NO-BREAK SPACE}").replace("-", "−")


def parameter_page(sweep: ParameterSweep) -> str:
    """Return the page.

    It shows heat maps over two keys, lines with intervals over one, and all points in a table.

    Args:
        sweep: what was found.
    """
    runs = max((columns["seed"].size for columns in sweep.columns), default=0)
    sections = [_answer_of_points(sweep)]
    for quantity in sweep.quantities:
        found = sweep.intervals(quantity.name)
        if any(np.isfinite(i.value) for i in found):
            blocks = (*_pictures(sweep, quantity, found), _table(sweep, quantity))
            sections.append(Section(title=capital(quantity.title), blocks=blocks))
    stopped = sum(int(columns["stopped"].sum()) for columns in sweep.columns)
    facts = (
        ("points", str(len(sweep.columns))), ("runs of each", str(runs)), ("stopped by safety", str(stopped)),
        ("seeds", "the same at every point: equal network laws meet equal delays"),
    )  # fmt: skip
    title = f"{sweep.experiment} over {', '.join(sweep.points.keys)}"
    return Page(title, sections, subtitle="Sweep over parameters", facts=facts).html()


def _answer_of_points(sweep: ParameterSweep) -> Section:
    """The best point of every quantity of which it is known which values are better."""
    said = [Text(title=q.title, text=sweep.answer(q.name)) for q in sweep.judged()]
    none = Text(text="No measure of this experiment states which value is better.")
    cautions = tuple(Text(text=each) for each in sweep.said())
    return Section(title="Answer", blocks=(*(said or (none,)), *cautions))


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
            low=float(finite.min()), high=float(finite.max()), note="the stronger the colour, the larger",
        )  # fmt: skip
        groups = {f"{points.keys[0]} {row}": found[i * len(columns) : (i + 1) * len(columns)] for i, row in enumerate(rows)}
        return [chart, _lines(points.keys[1], columns, groups, quantity)]
    if not points.axes and complete:
        every = [tuple(row[i] for row in points.values) for i in range(len(points.keys))]
        return [_lines(key, values, {"": found}, quantity, drawn=True) for key, values in zip(points.keys, every)]
    return []


def _lines(
    key: str, axis: tuple[str, ...], groups: dict[str, list[Interval]], quantity: Quantity, *, drawn: bool = False
) -> Block:
    """Return means over one key; of a Latin hypercube (`drawn`) its points, as their other keys differ, too."""
    x, unit = numbers_of(axis)
    label = with_unit(quantity.title, quantity.unit)
    if x is None or len(axis) < 2:
        bars = tuple(
            BarGroup(label=name or quantity.title, values=[i.value for i in line], whiskers=[ends_of(i) for i in line], colour=c)
            for c, (name, line) in enumerate(groups.items())
        )
        return Bars(title=f"{label}: mean, 95 % interval", categories=axis, groups=bars, x_label=key, y_label=label)
    order = np.argsort(x)
    scale = axis_for([np.array([end for line in groups.values() for i in line for end in (i.value, *ends_of(i))])])
    series, bands = [], []
    for colour, (name, line) in enumerate(groups.items()):
        mean, low, high = (np.array(side)[order] for side in zip(*((i.value, *ends_of(i)) for i in line)))
        series.append(Series(label=name or "mean", x=x[order], y=mean, colour=colour, marked=True,
                             style="circles" if drawn else "line"))  # fmt: skip
        bands.append(Band(label="95 % interval", x=x[order], lower=low, upper=high, colour=colour))
    return Figure(
        title=f"{label}: mean{'' if drawn else ', 95 % interval'}", series=tuple(series),
        bands=() if drawn else tuple(bands), x_label=key,
        x_unit=unit, y_label=quantity.title, y_unit=quantity.unit, y_log=scale.log, y_asinh=scale.asinh,
        sync=None, x_ticks=() if drawn else tuple(sorted(set(x.tolist()))),
        note="Computed at the marked points, not between. Every point has its own interval; as all points share their seeds, "
        f"the paired differences in the table are sharper. {scale.note}".strip(),
    )  # fmt: skip


def _table(sweep: ParameterSweep, quantity: Quantity) -> Block:
    best, (columns, rows) = sweep.best(quantity.name), sweep.table(quantity)
    note = "Differences are run by run, on the same seeds."
    if best is not None:
        note += " Each interval is of two points that were named before; the answer allows for the choice of the best."
    return Table(
        columns=columns, rows=[[*row[:-3], _in_one_line(row[-3]), row[-2], _in_one_line(row[-1])] for row in rows],
        highlight=frozenset() if best is None else frozenset({best}), note=note,
    )  # fmt: skip
