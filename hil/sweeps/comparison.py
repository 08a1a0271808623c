"""Several experiments under common random numbers: what they have in common, and paired differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.monte_carlo.confidence import Interval
from hil.experiment import Experiment
from hil.measure.measure import Quantity
from hil.sweeps.seeds import here, quantities_in, run_sweep


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What a comparison has found.

    Args:
        runs: number of seeds, the same for every experiment.
        values: experiment to columns of its sweep, one entry per seed: ``seed``, ``stopped`` and every quantity.
        quantities: what all experiments measure.
        interrupted: 130 if Ctrl-C came (143 if SIGTERM did), else 0; then some values are missing.
    """

    runs: int
    values: Mapping[str, Mapping[str, NDArray[np.float64]]]
    quantities: tuple[Quantity, ...]
    interrupted: int = 0

    def difference(self, name: str, quantity: str) -> dict[str, Any]:
        """Return the mean difference of an experiment against the first, and its 95 % interval; see `paired`."""
        first = next(iter(self.values))
        return paired(self.values[first][quantity], self.values[name][quantity])

    def verdict(self, name: str) -> str:
        """Return in words whether an experiment is better than the first, with the number that decides and its interval.

        It is judged by the first quantity of which it can be said what is better. Runs that safety stopped are shorter than
        the others, so that no verdict is given where there are any.
        """
        first = next(iter(self.values))
        judged = next((q for q in self.quantities if q.better), None)
        stops = {each: int(self.values[each]["stopped"].sum()) for each in (first, name)}
        if any(stops.values()):
            told = ", ".join(f"{each} in {count}" for each, count in stops.items())
            return f"{name} against {first}: undecided; safety stopped runs (of {self.runs}): {told}"
        if judged is None:
            return f"{name} against {first}: undecided; no measure states which value is better"
        gap = relative(self.values[first][judged.name], self.values[name][judged.name])
        if gap is None:
            return f"{name} against {first}: undecided; {judged.name} is not a number above 0 in two runs of both"
        value, low, high = (f"{100.0 * share:+.1f}" for share in (gap.value, gap.low, gap.high))
        numbers = f"{judged.name} {value} %, 95 % interval {low} to {high} %, {gap.n} runs"
        if gap.low <= 0.0 <= gap.high:
            return f"{name} against {first}: no difference is shown: {numbers}"
        better = (gap.value < 0.0) == (judged.better == "lower")
        return f"{name} is {'better' if better else 'worse'} than {first}: {numbers}"


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
        progress: told the experiment and how many of its runs have been done.
    """
    quantities = common_quantities([quantities_in(experiment) for experiment in experiments.values()])
    values: dict[str, Mapping[str, NDArray[np.float64]]] = {}
    for name, experiment in experiments.items():
        ran = run_sweep(experiment, range(runs), workers=here(jobs), progress=lambda done, name=name: progress(name, done))  # type: ignore[misc]
        if ran.interrupted:
            return Comparison(runs=runs, values=values, quantities=quantities, interrupted=ran.interrupted)
        values[name] = ran.values
    return Comparison(runs=runs, values=values, quantities=quantities)


def common_quantities(several: Sequence[Sequence[Quantity]]) -> tuple[Quantity, ...]:
    """Return the quantities that all of several experiments have; one whose unit differs between them has none."""
    first, *others = ({q.name: q for q in quantities} for quantities in several)
    return tuple(
        q if all(other[name].unit == q.unit for other in others) else replace(q, unit="")
        for name, q in first.items()
        if all(name in other for other in others)
    )


def relative(a: NDArray[np.float64], b: NDArray[np.float64]) -> Interval | None:
    """Return mean(b) / mean(a) - 1 over the seeds that both have, and its 95 % interval, normal, by the delta method.

    With q = mean(b) / mean(a) the deviation is that of the mean of (b - q a) / mean(a): pairs share their seed.

    Args:
        a, b: one entry per seed, in the same order.

    Returns:
        None for fewer than two pairs, or if mean(a) is not positive.
    """
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    if a.size < 2 or not a.mean() > 0.0:
        return None
    q = float(b.mean() / a.mean())
    half = 1.96 * float((b - q * a).std(ddof=1)) / (float(a.mean()) * float(np.sqrt(a.size)))
    return Interval(q - 1.0, q - 1.0 - half, q - 1.0 + half, 0.95, int(a.size))


def paired(a: NDArray[np.float64], b: NDArray[np.float64]) -> dict[str, Any]:
    """Return mean difference b - a over the seeds that both have, and its 95 % interval (normal, paired)."""
    both = np.isfinite(a) & np.isfinite(b)
    gap = (b - a)[both]
    if gap.size < 2:
        return {"n": int(gap.size), "mean": None, "low": None, "high": None}
    half = 1.96 * float(gap.std(ddof=1)) / float(np.sqrt(gap.size))
    mean = float(gap.mean())
    return {"n": int(gap.size), "mean": mean, "low": mean - half, "high": mean + half}
