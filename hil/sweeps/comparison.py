"""Several experiments under common random numbers: what they have in common, and paired differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from design.monte_carlo.confidence import EQUAL, Interval, difference_interval, ratio_interval
from hil.errors import HilError, unknown_name
from hil.experiment import Experiment
from hil.measure import Quantity
from hil.measure.signals import Array, with_unit
from hil.notebook import Result
from hil.sweeps.seeds import here, quantities_in, run_sweep, seeds_of
from hil.sweeps.shown import (
    SHORTER,
    ShownResult,
    Values,
    all_together,
    asked,
    interval_of,
    measured,
    paint_distributions,
    pairs,
    within,
)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Comparison(ShownResult):
    """What a comparison has found.

    Args:
        runs: number of seeds, the same for every experiment.
        values: experiment to columns of its sweep, one entry per seed: ``seed``, ``stopped`` and every quantity.
        quantities: what all experiments measure.
        interrupted: 130 if Ctrl-C came (143 if SIGTERM did), else 0; then some values are missing.
        cautions: experiment to what is to be said beside its mean of squared errors, where that does not converge well.
        alone: which measures kept the runs from being computed at once, nothing where none did.
    """

    runs: int
    values: Mapping[str, Mapping[str, Array]]
    quantities: tuple[Quantity, ...]
    interrupted: int = 0
    cautions: Mapping[str, str] = field(default_factory=dict)
    alone: str = ""

    def difference(self, name: str, quantity: str) -> Interval:
        """Return the mean difference of an experiment against the first over the seeds that both have, and its 95 % interval."""
        return difference_interval(*self._pairs(name, quantity))

    def _pairs(self, name: str, quantity: str) -> tuple[Array, Array]:
        if name not in self.values:
            raise unknown_name("experiment", name, self.values)
        return pairs(self.values[self.first][quantity], self.values[name][quantity])

    @property
    def first(self) -> str:
        """The experiment that the others are compared with."""
        return next(iter(self.values))

    @property
    def _level(self) -> float:
        return all_together(len(self.values) - 1)

    @property
    def stopped(self) -> bool:
        """Whether safety stopped a run."""
        return any(bool(values["stopped"].any()) for values in self.values.values())

    def measured(self) -> tuple[list[Quantity], str]:
        """Return the quantities that some run has, and a sentence on those that none has, nothing where there are none."""
        return measured(self.quantities, [*self.values.values()])

    def verdict(self, name: str) -> str:
        """Return in words whether an experiment is better than the first, with the number that decides and its interval.

        Whom safety stops more often is worse. Otherwise it is judged by the first quantity of which it is known what is better;
        runs that safety stopped are shorter than the others, so that no number of theirs is judged. Where one of them lacks a
        number that the other has in the same seed, a mean over the others would leave out the best or the worst runs.
        The level is that of all verdicts together: one by one, of eleven equal experiments one is called better or worse than
        the first in a quarter of all comparisons.
        """
        stops = self._verdict_on_stops(name)
        if stops is not None:
            return stops
        judged = next((q for q in self.quantities if q.better), None)
        if judged is None:
            return f"{name} against {self.first}: undecided; no number that they have in one unit says which value is better"
        undecided = f"{name} against {self.first}: undecided; {judged.title}"
        own, other = (np.isfinite(self.values[each][judged.name]) for each in (name, self.first))
        if (own != other).any():
            counts = f"{own.sum()} of its {self.runs} runs and in {other.sum()} of {self.first}"
            return f"{undecided} is a number in {counts}, not in the same ones"
        pairs = self._pairs(name, judged.name)
        gap = difference_interval(*pairs, self._level)
        if not (own.any() or other.any()) and any(q.name.startswith(f"{judged.name}.") for q in self.quantities):
            return f"{undecided} is not summed over outputs of several units; it stands below for each output"
        if gap.n < 2:
            return f"{undecided} is a number in {gap.n} runs of both, 2 are needed"
        if not gap.bounded:
            return f"{undecided} differs by the same {gap.value:+.4g} in all {gap.n} runs, and {EQUAL} are needed to show that"
        together = "" if len(self.values) < 3 else f" (95 % for all {len(self.values) - 1} together)"
        numbers = f"{judged.title} {_change(*pairs, judged.unit, self._level)}, {gap.n} runs{together}"
        if gap.low <= 0.0 <= gap.high:
            return f"{name} against {self.first}: no difference is shown: {numbers}"
        better = (gap.value < 0.0) == (judged.better == "lower")
        return f"{name} is {'better' if better else 'worse'} than {self.first}: {numbers}"

    def _runs(self) -> tuple[Mapping[str, Sequence[str]], Sequence[Values]]:
        return {"experiment": [*self.values]}, [*self.values.values()]

    def rows(self) -> list[list[Any]]:
        """Return a row per quantity that some run has, and experiment: runs, mean, paired difference, its interval."""
        found: list[list[Any]] = []
        for each in self.measured()[0]:
            for name, values in self.values.items():
                own, gap = interval_of(values[each.name]), self.difference(name, each.name)
                gap_cells = (None, None) if name == self.first or gap.n < 2 else (gap.value, within(gap))
                found.append([with_unit(each.title, each.unit), name, own.n, own.value if own.n else None, *gap_cells])
        return found

    def _result(self, quantity: str | None = None) -> Result:
        heads = ("quantity", "experiment", "runs", "mean", f"difference to {self.first}", "95 % interval")
        none = self.measured()[1]
        cautions = (f"{name}: {said}" for name, said in self.cautions.items())
        shorter = SHORTER if self.stopped else ""
        answer = [*map(self.verdict, list(self.values)[1:]), *cautions, *filter(None, (none, shorter))]
        paint = paint_distributions(self.values, asked(self.quantities, quantity, [*self.values.values()]))
        return Result(line=self._line(), answer=answer, columns=heads, rows=self.rows(), paint=paint)

    def __repr__(self) -> str:
        said = "; ".join(map(self.verdict, list(self.values)[1:]))
        return f"<{self._line()}{said and ': '}{said}>"

    def _line(self) -> str:
        return f"Comparison of {len(self.values)} experiment{'s' * (len(self.values) != 1)}, {self.runs} runs of each"

    def _verdict_on_stops(self, name: str) -> str | None:
        """What follows from the runs that safety stopped, None if there are none: McNemar's exact test on the pairs."""
        own, other = (self.values[each]["stopped"] > 0.0 for each in (name, self.first))
        if not own.any() and not other.any():
            return None
        from scipy.stats import binomtest  # half a second of CPU: only where a run was stopped

        counts = f"{own.sum() or 'none'} of its {self.runs} runs, {other.sum() or 'none'} of {self.first}"
        only_own, only_other = int((own & ~other).sum()), int((other & ~own).sum())
        p = float(binomtest(only_own, only_own + only_other).pvalue) if only_own + only_other else 1.0
        if p >= 1.0 - self._level:
            return f"{name} against {self.first}: undecided; safety stopped {counts} (as many by chance: p = {p:.2g})"
        return f"{name} is {'worse' if only_own > only_other else 'better'}: safety stopped {counts}"


def _change(a: Array, b: Array, unit: str, level: float) -> str:
    """The difference of the means with its interval, in per cent where the first mean is above 0 with certainty."""
    gap, share = difference_interval(a, b, level), ratio_interval(a, b, level)
    if gap.low == gap.high:
        return f"{' '.join(filter(None, (f'{gap.value:+.4g}', unit)))} in every pair (equal differences: no interval)"
    if a.mean() > 0.0 and share.bounded:
        value, low, high = (f"{100.0 * (q - 1.0):+.1f}" for q in (share.value, share.low, share.high))
        return f"{value} %, {100.0 * level:.4g} % interval {low} to {high} %"
    number = f"{gap.value:+.4g}, {100.0 * level:.4g} % interval {gap.low:+.4g} to {gap.high:+.4g}"
    return f"{number} {unit}" if unit else number


def check_named(names: Sequence[str], alone: str, again: str) -> None:
    """Refuse fewer than two experiments, and one that is named twice.

    Args:
        names: of the experiments, as they are compared.
        alone: what runs one experiment.
        again: what makes two of one.

    Raises:
        HilError: with what helps.
    """
    if not names:
        raise HilError("compare: no experiment is named; expected two or more")
    if len(names) < 2:
        raise HilError(f"compare: only {names[0]!r} is named; expected two or more, of one: {alone}")
    if twice := next((name for i, name in enumerate(names) if name in names[:i]), ""):
        raise HilError(f"compare: {twice!r} is named twice; {again}")


def compare(
    experiments: Mapping[str, Experiment],
    runs: int,
    *,
    jobs: int = -1,
    progress: Callable[[str, int], None] = lambda name, done: None,
) -> Comparison:
    """Run experiments for the seeds 0, 1, ...; those with the same network laws meet the same delays.

    Args:
        experiments: by the name that tables and pages give them; differences are against the first.
        runs: of each.
        jobs: processes on this machine, -1 for one per core.
        progress: called with the experiment and how many of its runs have been done.

    Raises:
        HilError: fewer than two runs, or no measure is common to all of them.
    """
    seeds, workers = seeds_of(runs, least=2), here(jobs)
    quantities = common_quantities([quantities_in(experiment) for experiment in experiments.values()])
    if not quantities:
        lacking = "no number that all have in one unit; name one measure in the [report] of each"
        raise HilError(f"compare: {', '.join(experiments)}: {lacking}")
    values: dict[str, Mapping[str, Array]] = {}
    cautions: dict[str, str] = {}
    alone = ""
    for name, experiment in experiments.items():
        ran = run_sweep(experiment, seeds, workers=workers, progress=lambda done, name=name: progress(name, done))  # type: ignore[misc]
        if ran.interrupted:
            return Comparison(runs=runs, values=values, quantities=quantities, interrupted=ran.interrupted)
        values[name], alone = ran.values, alone or ran.alone
        if ran.caution:
            cautions[name] = ran.caution
    return Comparison(runs=runs, values=values, quantities=quantities, cautions=cautions, alone=alone)


def common_quantities(several: Sequence[Sequence[Quantity]]) -> tuple[Quantity, ...]:
    """Return the quantities that all of several experiments have, each in one unit: others have no difference."""
    first, *others = ({q.name: q for q in quantities} for quantities in several)
    return tuple(q for name, q in first.items() if all(name in each and each[name].unit == q.unit for each in others))
