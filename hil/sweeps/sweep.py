"""What a sweep has found: the numbers of its runs, and what a notebook shows of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from design.monte_carlo.confidence import Interval
from hil.measure.measure import Quantity
from hil.measure.signals import with_unit
from hil.notebook import Result, data_frame
from hil.sweeps.shown import ShownResult, asked, interval_of, mean_and_interval, paint_distributions, stopped_in_words, within

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, slots=True, repr=False)
class Sweep(ShownResult):
    """What a sweep has found.

    Args:
        values: ``seed``, ``stopped`` and every metric, one entry per run in the order of the seeds.
        interrupted: 130 if Ctrl-C came (143 if SIGTERM did), else 0; the values are those of the runs that were done.
        interval, reached: with a stopping rule, its interval (None before the first look) and whether it is narrow enough.
        caution: what is to be said beside the numbers, nothing where all is well: the first run withdrew the certificate, or a
            mean of squared errors does not converge; see `hil.compose.fourth_moments`.
        alone: which measures kept the runs from being computed at once, nothing where none did.
        experiment, quantities: its name, and what it measures.
    """

    values: Mapping[str, NDArray[np.float64]]
    interrupted: int
    interval: Interval | None = None
    reached: bool = False
    caution: str = ""
    alone: str = ""
    experiment: str = ""
    quantities: tuple[Quantity, ...] = ()

    def to_pandas(self) -> pandas.DataFrame:
        """Return a row per run: the seed, whether safety stopped it, every quantity; the units are in ``attrs``.

        Raises:
            HilError: if pandas is not installed.
        """
        whole: dict[str, Any] = {name: self.values[name].astype(np.int64) for name in ("seed", "stopped")}
        return data_frame(dict(self.values) | whole, {q.name: q.unit for q in self.quantities})

    def _result(self, quantity: str | None = None) -> Result:
        of = asked(self.quantities, quantity)
        rows: list[list[Any]] = []
        for each in self.quantities:
            s, inner = statistics(self.values[each.name]), within(interval_of(self.values[each.name]))
            shares = (s["percentiles"].get(p) for p in ("5", "50", "95"))
            rows.append([with_unit(each.name, each.unit), s["n"], s["mean"], inner, s["sd"], *shares])
        heads = ("quantity", "runs", "mean", "95 % interval", "sd", "5 %", "50 %", "95 %")
        told = f"{mean_and_interval(self.values[of.name], of)}; {stopped_in_words(self.values)}"
        paint = paint_distributions({self.experiment: self.values}, of)
        answer = [told, *filter(None, [self.caution])]
        return Result(line=repr(self)[1:-1], answer=answer, columns=heads, rows=rows, paint=paint)

    def __repr__(self) -> str:
        of, runs = asked(self.quantities, None), self.values["seed"].size
        told = mean_and_interval(self.values[of.name], of)
        return f"<Sweep {self.experiment}: {runs} runs, {told}, {stopped_in_words(self.values)}>"


def statistics(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return mean, standard deviation, standard error and percentiles of one metric over the runs that have it."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return {"n": 0, "mean": None, "sd": None, "se": None, "percentiles": {}}
    sd = float(finite.std(ddof=1)) if finite.size > 1 else 0.0
    points = (1, 5, 25, 50, 75, 95, 99)
    return {
        "n": int(finite.size),
        "mean": float(finite.mean()),
        "sd": sd,
        "se": sd / float(np.sqrt(finite.size)),
        "percentiles": {str(p): float(v) for p, v in zip(points, np.percentile(finite, points))},
    }
