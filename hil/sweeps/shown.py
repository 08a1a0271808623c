"""Results of many runs as they are shown: sentences, a table of every number, a plot of one of them, and the axis of a plot."""

from __future__ import annotations

import csv
import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from design.monte_carlo.confidence import Interval, mean_interval
from hil.errors import unknown_name
from hil.measure import Quantity
from hil.measure.signals import with_unit
from hil.notebook import Result, data_frame, literal

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Values = Mapping[str, NDArray[np.float64]]


class ShownResult(ABC):
    """What a notebook and a paper show of many runs; a result says what that is by `_result`, and which runs by `_runs`."""

    __slots__ = ()

    quantities: tuple[Quantity, ...]

    @abstractmethod
    def _result(self, quantity: str | None = None) -> Result:
        """Return what is shown, with the plot of a quantity."""

    @abstractmethod
    def _runs(self) -> tuple[Mapping[str, Sequence[str]], Sequence[Values]]:
        """Return the columns of each group of runs, and what tells the groups apart: a word for each, by name."""

    def _columns(self) -> dict[str, NDArray[Any]]:
        """Return a row per run: of which group it is, the seed, whether safety stopped it, every quantity."""
        words, groups = self._runs()
        table: dict[str, Any] = {name: np.repeat(each, [len(group["seed"]) for group in groups]) for name, each in words.items()}
        for name, kind in {"seed": np.int64, "stopped": np.int64, **{q.name: np.float64 for q in self.quantities}}.items():
            table[name] = np.concatenate([np.empty(0, kind), *(group[name].astype(kind) for group in groups)])
        return table

    def to_pandas(self) -> pandas.DataFrame:
        """Return a row per run: of which group it is, the seed, whether safety stopped it, every quantity.

        The units are in ``attrs``.

        Raises:
            HilError: if pandas is not installed.
        """
        return data_frame(self._columns(), {q.name: q.unit for q in self.quantities})

    def csv_text(self) -> str:
        """Return the same rows as CSV; a number that a run has not is empty."""
        text, table = io.StringIO(), self._columns()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(table)
        writer.writerows(["" if v != v else v for v in row] for row in zip(*(column.tolist() for column in table.values())))
        return text.getvalue()

    def plot(
        self, path: str | Path | None = None, *, quantity: str | None = None, width_mm: float = 85.0, height_mm: float = 70.0
    ) -> Figure:
        """Draw a quantity, its distribution or its mean at every point; write it to a file where one is named.

        Args:
            path: ends in .svg, .pdf or .png.
            quantity: its name; without one the first that some run has and of which it is known which values are better.
            width_mm, height_mm: of the figure as it is printed.

        Raises:
            HilError: no such quantity, or the figure cannot be drawn or written.
        """
        return self._result(quantity).plot(path, width_mm, height_mm)

    def _repr_html_(self) -> str:
        return self._result().html()


def measured(quantities: Sequence[Quantity], runs: Sequence[Values]) -> tuple[list[Quantity], str]:
    """Return the quantities that some run has, and a sentence on those that none has, nothing where there are none.

    Args:
        quantities: of all runs.
        runs: their columns by name.

    >>> late = Quantity(name="late", title="error after 5 s")
    >>> measured([late], [{"late": np.array([np.nan, np.nan])}])
    ([], 'no run has a number for: error after 5 s')
    """
    found = [q for q in quantities if any(np.isfinite(columns[q.name]).any() for columns in runs)]
    none = [q.title for q in quantities if q not in found]
    return found, f"no run has a number for: {', '.join(none)}" if none else ""


def interval_of(values: NDArray[np.float64], level: float = 0.95) -> Interval:
    """Return the mean over the runs that have a number, and its interval."""
    return mean_interval(values[np.isfinite(values)], level)


def all_together(intervals: int) -> float:
    """Return the level at which so many intervals hold, all of them, with 95 % (Bonferroni): one may be chosen by its values.

    >>> all_together(1), round(all_together(10), 3)
    (0.95, 0.995)
    """
    return 1.0 - 0.05 / max(intervals, 1)


def pairs(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two columns over the same seeds, of the runs that have both numbers."""
    both = np.isfinite(a) & np.isfinite(b)
    return a[both], b[both]


def asked(quantities: Sequence[Quantity], name: str | None, runs: Sequence[Values]) -> Quantity:
    """Return a quantity by its name; without one the first that some run has and of which it is known which values are better.

    Raises:
        UnknownName: there is none of that name.
    """
    if name is None:
        found = measured(quantities, runs)[0] or quantities
        return next((q for q in found if q.better), found[0])
    for quantity in quantities:
        if quantity.name == name:
            return quantity
    raise unknown_name("quantity", name, [q.name for q in quantities])


def within(interval: Interval) -> str | None:
    """Return an interval in words, exponents as in a table's numbers; None where it is infinitely wide or has no width.

    >>> within(Interval(value=1.0, low=-3e-7, high=2.5, level=0.95, n=9))
    '-3e-7 to 2.5'
    """
    known = interval.bounded and interval.low < interval.high
    return f"{interval.low:.5g} to {interval.high:.5g}".replace("e-0", "e-") if known else None


def as_plain(interval: Interval) -> dict[str, float | int | None]:
    """Return mean, ends and number of runs as JSON has them: no mean of no run, no ends of an infinite interval."""
    low, high = (interval.low, interval.high) if interval.bounded else (None, None)
    return {"n": interval.n, "mean": interval.value if interval.n else None, "low": low, "high": high}


def ends_of(interval: Interval) -> tuple[float, float]:
    """Return the ends of an interval, the value alone where it is infinitely wide."""
    return (interval.low, interval.high) if interval.bounded else (interval.value, interval.value)


def mean_and_interval(values: NDArray[np.float64], quantity: Quantity, of: int = 1) -> str:
    """Return the mean of a quantity with its interval, in one line, and how many runs it is over where some lack the number.

    Args:
        values: of the runs.
        quantity: what they are of.
        of: means from which this one was chosen.
    """
    found = interval_of(values, all_together(of))
    if not found.n:
        return f"{quantity.title} undefined in all runs"
    unit = f" {quantity.unit}" if quantity.unit else ""
    inner = within(found)
    over = f" over the {found.n} of {values.size} runs that have it" if found.n < values.size else ""
    return f"{quantity.title} {found.value:.5g}{unit} on average{over}" + (f", 95 % interval {inner}" if inner else "")


def stopped_in_words(values: Values) -> str:
    """Return how many of the runs safety stopped."""
    count, runs = int(values["stopped"].sum()), values["stopped"].size
    return f"safety stopped {count or 'none'} of {runs} runs" + (f"; {SHORTER}" if count else "")


SHORTER = "means are over the shorter runs too, whose sums are of fewer slots"
"""What is to be said beside a mean where safety stopped runs."""


CRUSHED = 20.0
"""Largest size above the smallest median size from which a linear axis shows no difference of the smaller ones."""
DECADES = 1e6
"""Largest size beside the one within which an asinh axis is linear, at most: six decades on either side."""


class Axis(NamedTuple):
    """A logarithmic axis, or one that is linear up to a size and logarithmic beyond (asinh), or, with neither, a linear one."""

    log: bool = False
    asinh: float | None = None

    @property
    def note(self) -> str:
        """What a plot says of its axis, nothing of a linear one."""
        if self.asinh is None:
            return "The axis is logarithmic." if self.log else ""
        return f"The axis is linear up to {self.asinh:.2g} on both sides of 0, and logarithmic beyond."


def axis_for(groups: Sequence[NDArray[np.float64]]) -> Axis:
    """Return the axis for some groups of values.

    Args:
        groups: values that are compared; those that are not finite do not count.

    >>> axis_for([np.array([11.0, 12.0]), np.array([350.0])])
    Axis(log=True, asinh=None)
    >>> axis_for([np.array([-0.5, 0.5, 1.0]), np.array([-300.0, 2.0])])
    Axis(log=False, asinh=0.5)
    >>> axis_for([np.array([-1.0, 2.0]), np.array([3.0])])
    Axis(log=False, asinh=None)
    """
    finite = [values[np.isfinite(values)] for values in groups]
    sizes = [np.abs(values) for values in finite if values.size]
    medians = [float(np.median(size)) for size in sizes if size.any()]
    largest = max((float(size.max()) for size in sizes), default=0.0)
    usual = min((median for median in medians if median > 0.0), default=0.0)
    if not 0.0 < CRUSHED * usual < largest:
        return Axis()
    if min(float(values.min()) for values in finite if values.size) > 0.0:
        return Axis(log=True)
    return Axis(asinh=max(usual, largest / DECADES))


def distributions(found: Mapping[str, NDArray[np.float64]]) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return empirical distribution functions: each from 0, at the least value of all, to 1, at the largest of all.

    Args:
        found: values of each group; those that are not finite are left out, and a group of none.

    Returns:
        of each group the values, increasing, and the share of runs at or below each.
    """
    finite = {name: kept for name, values in found.items() if (kept := values[np.isfinite(values)]).size}
    every = np.concatenate([np.empty(0), *finite.values()])
    made = {}
    for name, values in finite.items():
        x, counts = np.unique(values, return_counts=True)
        y = np.cumsum(counts) / values.size
        if x[0] > every.min():
            x, y = np.append(every.min(), x), np.append(0.0, y)
        if x[-1] < every.max():
            x, y = np.append(x, every.max()), np.append(y, 1.0)
        made[name] = x, y
    return made


def paint_distributions(groups: Mapping[str, Values], quantity: Quantity) -> Callable[[Figure], None]:
    """Return what draws the share of runs at or below each value, a line for each group."""

    def paint(sheet: Figure) -> None:
        axis = sheet.subplots()
        for name, (x, y) in distributions({name: values[quantity.name] for name, values in groups.items()}).items():
            axis.step(np.append(x[:1], x), np.append(0.0, y), where="post", label=literal(name))
        kind = axis_for([values[quantity.name] for values in groups.values()])
        if kind.log:
            axis.set_xscale("log")
        elif kind.asinh is not None:
            axis.set_xscale("asinh", linear_width=kind.asinh)
        axis.set_xlabel(literal(with_unit(quantity.title, quantity.unit)))
        axis.set_ylabel("share of runs at or below")
        axis.set_ylim(0.0, 1.0)
        if len(groups) > 1:
            axis.legend()

    return paint


def paint_points(
    x: NDArray[np.float64] | None, labels: Sequence[str], x_label: str, groups: Mapping[str, Sequence[Interval]],
    quantity: Quantity,
) -> Callable[[Figure], None]:  # fmt: skip
    """Return what draws means with their intervals: over numbers where there are any, else over words."""

    def paint(sheet: Figure) -> None:
        axis = sheet.subplots()
        at = np.arange(len(labels), dtype=np.float64) if x is None else x
        order: Any = np.argsort(at, kind="stable")
        for name, found in groups.items():
            mean = np.array([i.value for i in found])
            ends = np.array([*map(ends_of, found)])
            bars = np.abs(ends.T - mean)[:, order]  # an interval of a skewed quantity has its mean not in the middle
            line = "" if x is None else "-"
            axis.errorbar(at[order], mean[order], yerr=bars, marker="o", linestyle=line, capsize=3, label=literal(name) or None)
        if x is None:
            axis.set_xticks(at, [*map(literal, labels)])
        axis.set_xlabel(literal(x_label))
        axis.set_ylabel(literal(with_unit(quantity.title, quantity.unit)))
        if len(groups) > 1:
            axis.legend()

    return paint
