"""The axis of values that are compared: an outlier crushes nothing, on a page and in a notebook."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from hil.measure.measure import Quantity
from hil.sweeps.shown import (
    CRUSHED,
    DECADES,
    Axis,
    axis_for,
    ends_of,
    interval_of,
    mean_and_interval,
    paint_distributions,
    within,
)
from hil.sweeps.sweep import statistics


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_an_axis_follows_its_values_whatever_their_unit(unit: float) -> None:
    def axis(*groups: list[float]) -> Axis:
        return axis_for([unit * np.array(group) for group in groups])

    assert axis([11.0, 12.0], [350.0]) == Axis(log=True)
    assert axis([1.0, 1.0], [float("nan")], [CRUSHED]) == axis() == axis([]) == axis([0.0, 0.0, 9e9]) == Axis()
    assert axis([1.0, 1.0], [1.01 * CRUSHED]) == Axis(log=True)
    assert axis([0.0, 1.0, 1.0], [1.01 * CRUSHED]).asinh == pytest.approx(unit)
    assert axis([0.0, 1.0, 1.0], [2.0 * 10.0**9]).asinh == pytest.approx(2e9 * unit / DECADES)


def test_a_mean_says_over_how_many_runs_it_is() -> None:
    quantity = Quantity(name="reach", title="time to reach", unit="s")
    said = "time to reach 1 s on average"
    assert mean_and_interval(np.array([1.0, 1.0, np.nan]), quantity) == f"{said} over the 2 of 3 runs that have it"
    assert mean_and_interval(np.array([1.0, 1.0]), quantity) == said


@pytest.mark.parametrize(("far", "scale"), [([350.0, 800.0], "log"), ([-350.0, 800.0], "asinh"), ([11.5, 12.5], "linear")])
def test_a_plot_of_several_experiments_takes_it(far: list[float], scale: str) -> None:
    sheet = Figure()
    values = {"near": {"sse": np.array([11.0, 12.0])}, "far": {"sse": np.array(far)}}
    paint_distributions(values, Quantity(name="sse", title="squared tracking error", unit="rad² s", better="lower"))(sheet)
    assert sheet.axes[0].get_xscale() == scale


def test_an_interval_is_written_with_a_minus_and_not_at_all_where_it_has_no_end() -> None:
    assert within(interval_of(np.array([-3.0, -1.0, 1.0, 3.0]))) == "−4.1085 to 4.1085"
    assert within(interval_of(np.array([1.0]))) is None and ends_of(interval_of(np.array([1.0]))) == (1.0, 1.0)


def test_statistics_are_those_of_the_runs_that_have_a_number() -> None:
    found = statistics(np.array([1.0, np.nan, 3.0, np.inf]))
    assert (found["n"], found["mean"], found["sd"], found["se"]) == (2, 2.0, pytest.approx(2.0**0.5), pytest.approx(1.0))
    assert found["percentiles"] == pytest.approx({str(p): 1.0 + p / 50.0 for p in (1, 5, 25, 50, 75, 95, 99)})
    one = statistics(np.array([5.0, np.nan]))
    assert (one["n"], one["mean"], one["sd"], one["se"]) == (1, 5.0, 0.0, 0.0)
    none = statistics(np.array([np.nan]))
    assert none == {"n": 0, "mean": None, "sd": None, "se": None, "percentiles": {}}
