"""The axis of values that are compared: an outlier crushes nothing, on a page and in a notebook."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from hil.measure.measure import Quantity
from hil.sweeps.shown import CRUSHED, DECADES, Axis, axis_for, paint_distributions


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_an_axis_follows_its_values_whatever_their_unit(unit: float) -> None:
    def axis(*groups: list[float]) -> Axis:
        return axis_for([unit * np.array(group) for group in groups])

    assert axis([11.0, 12.0], [350.0]) == Axis(log=True)
    assert axis([1.0, 1.0], [float("nan")], [CRUSHED]) == axis() == axis([]) == axis([0.0, 0.0, 9e9]) == Axis()
    assert axis([1.0, 1.0], [1.01 * CRUSHED]) == Axis(log=True)
    assert axis([0.0, 1.0, 1.0], [1.01 * CRUSHED]).asinh == pytest.approx(unit)
    assert axis([0.0, 1.0, 1.0], [2.0 * 10.0**9]).asinh == pytest.approx(2e9 * unit / DECADES)


@pytest.mark.parametrize(("far", "scale"), [([350.0, 800.0], "log"), ([-350.0, 800.0], "asinh"), ([11.5, 12.5], "linear")])
def test_a_plot_of_several_experiments_takes_it(far: list[float], scale: str) -> None:
    sheet = Figure()
    values = {"near": {"sse": np.array([11.0, 12.0])}, "far": {"sse": np.array(far)}}
    paint_distributions(values, Quantity(name="sse", title="squared tracking error", unit="rad² s", better="lower"))(sheet)
    assert sheet.axes[0].get_xscale() == scale
