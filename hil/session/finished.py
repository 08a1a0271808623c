"""What a finished run leaves behind: its summary, its log, and both in a notebook."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.experiment import Experiment
from hil.log.read.arrays import StructuredArray
from hil.log.run import Run
from hil.measure.measure import Named, measures_of, quantities_of
from hil.measure.signals import signals_of

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Session:
    """What a finished run leaves behind.

    Args:
        log: returns the log, read when it is first asked for.
        summary: what ``hil run --json`` prints.
        status: exit status: 0, 1 the rig died or the log is not whole, 3 stopped by safety,
            5 a second controller answered too, 6 the link was flooded, 7 the plant or the controller was not what it says,
            130 or 143 interrupted.
        experiment: what ran.
    """

    log: Callable[[], Run]
    summary: dict[str, Any]
    status: int
    experiment: Experiment | None = None

    @property
    def run(self) -> Run:
        """The log, read back; it takes memory for every record."""
        return self.log()

    @property
    def metrics(self) -> dict[str, Any]:
        """The numbers of the experiment's measures, by name; ``summary["units"]`` has their units."""
        return Named("metric", self.summary["metrics"])

    @property
    def arrays(self) -> Mapping[str, StructuredArray]:
        """Topic to records, a structured numpy array each; field ``t_ns`` is the session time."""
        return self.run.arrays

    def to_pandas(self) -> dict[str, pandas.DataFrame]:
        """Return the arrays as tables of pandas; see `hil.session.shown.tables`."""
        from hil.session.shown import tables

        return tables(self.run)

    def to_xarray(self) -> dict[str, xarray.Dataset]:
        """Return the arrays as data sets of xarray; see `hil.session.shown.datasets`."""
        from hil.session.shown import datasets

        return datasets(self.run)

    def plot(self, path: str | Path | None = None, *, width_mm: float = 85.0, height_mm: float = 70.0) -> Figure:
        """Return outputs, reference and inputs as a figure of matplotlib, and write it to a file; see `shown.figure`."""
        from hil.session.shown import figure

        return figure(self.run, path, width_mm=width_mm, height_mm=height_mm)

    def _repr_html_(self) -> str:
        from hil.session.shown import cell

        of = self.experiment
        quantities = () if of is None else quantities_of(measures_of(of), signals_of(of.plant))
        return cell(self.run, self.summary, repr(self), quantities)

    def __repr__(self) -> str:
        s, metrics = self.summary, self.summary["metrics"]
        number, value = next(((k, v) for k, v in metrics.items() if isinstance(v, float)), ("", None))
        value_text = "" if value is None else f", {number} {value:.5g}"
        safety = ", stopped by safety" if s.get("safety") else ""
        return f"<Session {s['experiment']} seed {s['seed']}, {s['clock']} time, {s['slots']} slots{value_text}{safety}>"
