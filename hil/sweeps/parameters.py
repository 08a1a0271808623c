"""Sweeps over parameters: points of a grid or of a Latin hypercube, each run for the same seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from design.monte_carlo import Workers
from design.monte_carlo.confidence import Interval, difference_interval
from hil.compose import compose
from hil.errors import HilError, located
from hil.experiment import Experiment
from hil.measure import Quantity
from hil.measure.signals import Array, with_unit
from hil.notebook import Result
from hil.sweeps import SweepStore
from hil.sweeps.comparison import common_quantities
from hil.sweeps.points import Points, numbers_of
from hil.sweeps.seeds import columns_of, quantities_in, run_sweep
from hil.sweeps.shown import ShownResult, Values, all_together, asked, interval_of, mean_and_interval, paint_points, pairs, within

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_CAUTIONS = 5
"""Points whose caution is written out."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class ParameterSweep(ShownResult):
    """What a sweep over parameters has found.

    Args:
        experiment: its name.
        points: where it was run.
        columns: per point that was done, column to one entry per seed: ``seed``, ``stopped`` and every quantity.
        quantities: what every point measures.
        interrupted: 130 if Ctrl-C came (143 if SIGTERM did), else 0; then the last points are missing.
        alone: which measures kept the runs from being computed at once, nothing where none did.
        cautions: point to what is to be said beside its mean of squared errors, where that does not converge well.
    """

    experiment: str
    points: Points
    columns: tuple[Mapping[str, Array], ...]
    quantities: tuple[Quantity, ...]
    interrupted: int = 0
    alone: str = ""
    cautions: Mapping[int, str] = field(default_factory=dict)

    def said(self) -> tuple[str, ...]:
        """Return the cautions, a sentence a point; of many points those of the first ones, and how many there are."""
        if len(self.cautions) == len(self.columns) > len({*self.cautions.values()}) == 1:
            return (f"at every point: {self.cautions[0]}",)
        shown = [f"{', '.join(self.points.changes(n))}: {said}" for n, said in list(self.cautions.items())[:MOST_CAUTIONS]]
        more = len(self.cautions) - len(shown)
        return (*shown, f"{more} more points have a caution of this kind") if more else tuple(shown)

    def intervals(self, quantity: str) -> list[Interval]:
        """Return the mean of a quantity at every point that was done, and its 95 % interval."""
        return [interval_of(columns[quantity]) for columns in self.columns]

    def best(self, quantity: str) -> int | None:
        """Return the point whose mean is best of those that are `whole`; None where there is none, or no value is better."""
        better, whole = asked(self.quantities, quantity, self.columns).better, self.whole(quantity)
        if not better or not whole:
            return None
        return (min if better == "lower" else max)(whole, key=lambda p: float(self.columns[p][quantity].mean()))

    def whole(self, quantity: str) -> list[int]:
        """Return the points all of whose runs went to their end and have a number.

        A run that safety stopped has a sum over fewer slots: the sooner, the smaller.
        """
        return [p for p, c in enumerate(self.columns) if np.isfinite(c[quantity]).all() and not c["stopped"].any()]

    def judged(self) -> list[Quantity]:
        """Return the quantities of which it is known which values are better, and that some run has."""
        return [q for q in self.quantities if q.better and any(np.isfinite(c[q.name]).any() for c in self.columns)]

    def difference(self, point: int, against: int, quantity: str, level: float = 0.95) -> Interval:
        """Return the mean difference of a point against another over the seeds that both have, and its interval."""
        return difference_interval(*pairs(self.columns[against][quantity], self.columns[point][quantity]), level)

    def answer(self, quantity: str) -> str:
        """Return in words which point is best, and from how many others a paired difference distinguishes it.

        The best is chosen by its values: of 20 equal points its own 95 % interval misses in a third of all sweeps, and a fifth of
        the others differ from it by 95 % intervals. So the levels are those of all points, and of all pairs, together.
        """
        best, asked_for, whole = self.best(quantity), asked(self.quantities, quantity, self.columns), self.whole(quantity)
        if not asked_for.better:
            return f"{asked_for.title}: no measure states which value is better"
        if best is None:
            return f"{asked_for.title}: no point is best; at each safety stopped a run, or a run has no number"
        others = [p for p in whole if p != best]
        level = all_together(len(whole) * len(others) // 2)
        gaps = [self.difference(p, best, quantity, level) for p in others]
        clear = sum(g.n > 1 and (g.low > 0.0 or g.high < 0.0) for g in gaps)
        mean = mean_and_interval(self.columns[best][quantity], asked_for, len(whole))
        text = f"best point: {', '.join(self.points.changes(best))}; {mean}"
        if others:
            text += f"; {clear} of {len(others)} other points differ on the same seeds (95 % for all points together)"
        if not_whole := len(self.columns) - len(whole):
            points = "points are" if not_whole > 1 else "point is"
            text += f"; {not_whole} {points} not judged: safety stopped a run, or a run has no number"
        return text

    def _runs(self) -> tuple[Mapping[str, Sequence[str]], Sequence[Values]]:
        done = self.points.values[: len(self.columns)]
        return {key: [row[i] for row in done] for i, key in enumerate(self.points.keys)}, self.columns

    def _result(self, quantity: str | None = None) -> Result:
        of = asked(self.quantities, quantity, self.columns)
        heads, rows = self.table(of)
        paint = self._paint(of, self.intervals(of.name))
        return Result(line=repr(self)[1:-1], answer=[self.answer(of.name)], columns=heads, rows=rows, paint=paint)

    def table(self, of: Quantity) -> tuple[list[str], list[list[Any]]]:
        """Return what the columns of a quantity's table are, and a row per point that was done.

        Each has the point's fields, its runs, mean and interval, the paired difference to the best point, to the first where none
        is best, and its interval.
        """
        best = self.best(of.name)
        against, rows = best or 0, []
        for point, own in enumerate(self.intervals(of.name)):
            gap = self.difference(point, against, of.name)
            cells = (None, None) if point == against or gap.n < 2 else (gap.value, within(gap))
            rows.append([*self.points.values[point], own.n, own.value if own.n else None, within(own), *cells])
        which = "first" if best is None else "best"
        mean, gaps = (with_unit(head, of.unit) for head in ("mean", f"difference to the {which} point"))
        return [*self.points.keys, "runs", mean, "95 % interval", gaps, "its 95 % interval"], rows

    def _paint(self, of: Quantity, found: list[Interval]) -> Callable[[Figure], None]:
        points, done = self.points, self.points.values[: len(found)]
        if len(points.keys) == 1 or len(points.axes) == 2:
            lines: dict[str, list[int]] = {}
            for number, row in enumerate(done):
                lines.setdefault(f"{points.keys[0]} {row[0]}" if len(row) == 2 else "", []).append(number)
            axis = [done[p][-1] for p in next(iter(lines.values()))]
            x, unit = numbers_of(axis)
            whole = {name: [found[p] for p in members] for name, members in lines.items() if len(members) == len(axis)}
            return paint_points(x, axis, with_unit(points.keys[-1], unit), whole, of)
        labels = [str(number + 1) for number in range(len(found))]
        return paint_points(None, labels, f"point ({', '.join(points.keys)})", {"": found}, of)

    def __repr__(self) -> str:
        runs = max((columns["seed"].size for columns in self.columns), default=0)
        over = ", ".join(self.points.keys)
        return f"<ParameterSweep {self.experiment} over {over}: {len(self.columns)} points, {runs} runs at each>"


def load_points(load: Callable[[list[str]], Experiment], points: Points) -> list[Experiment]:
    """Return the experiment at every point, all checked before anything runs.

    Args:
        load: reads the experiment with some changes, as ``--set`` takes them.
        points: where.

    Raises:
        HilError: if a point is no valid experiment; the message names its changes.
    """
    found = []
    for number in range(len(points.values)):
        with located(", ".join(points.changes(number)), HilError):
            found.append(load(points.changes(number)))
    return found


def sweep_parameters(
    experiments: Sequence[Experiment],
    points: Points,
    *,
    seeds: range,
    workers: Workers,
    folder: Path | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> ParameterSweep:
    """Run an experiment at every point for the same seeds, so that points with the same network laws meet the same delays.

    Args:
        experiments: one for every point, as `load_points` returns them.
        points: where.
        seeds: at each point, a run each.
        workers: where the runs are computed.
        folder: finished runs are kept in here, a file per point, and taken from there instead of being run again.
        progress: called with how many runs of all have been done.

    Raises:
        HilError: if a point cannot be composed, or the folder holds something else.
    """
    quantities = common_quantities([quantities_in(e) for e in experiments])
    done: list[Mapping[str, Array]] = []
    if folder is not None:
        with located(f"--resume: {folder}", OSError):
            folder.mkdir(parents=True, exist_ok=True)
    alone = ""

    cautions: dict[int, str] = {}

    def made(**ended: Any) -> ParameterSweep:
        return ParameterSweep(
            experiment=experiments[0].name, points=points, columns=tuple(done), quantities=quantities, cautions=cautions, **ended
        )

    for number, experiment in enumerate(experiments):
        before = number * len(seeds)
        name = sha256("\n".join(points.changes(number)).encode()).hexdigest()[:16]
        with located(", ".join(points.changes(number)), HilError):
            loop, columns = compose(experiment), columns_of(experiment)
            with nullcontext() if folder is None else SweepStore(folder / f"{name}.jsonl", experiment, columns, loop) as store:
                found = run_sweep(
                    experiment,
                    seeds,
                    workers=workers,
                    progress=lambda n, before=before: progress(before + n),  # type: ignore[misc]
                    store=store,
                    loop=loop,
                )
        if found.interrupted:
            return made(interrupted=found.interrupted)
        done.append(found.values)
        cautions |= {number: found.caution} if found.caution else {}
        alone = alone or found.alone
    return made(alone=alone)
