"""Pages of many runs: what was computed is marked, the best point is said, an outlier presses nothing onto the axis."""

from __future__ import annotations

import numpy as np
import pytest

from hil.measure.measure import Quantity
from hil.pages.many_runs import _shares
from hil.sweeps.parameters import ParameterSweep
from hil.sweeps.points import grid

SSE = Quantity(name="sse", title="squared tracking error", unit="rad² s", better="lower")


def columns(values: np.ndarray) -> dict[str, np.ndarray]:
    return {"seed": np.arange(values.size, dtype=float), "stopped": np.zeros(values.size), "sse": values}


@pytest.fixture(scope="module")
def sweep() -> ParameterSweep:
    """Two points that share their seeds: the spread over seeds hides a difference of 0.1, the pairs show it."""
    drawn = 10.0 + np.random.default_rng(0).standard_normal(30)
    noise = 0.01 * np.random.default_rng(1).standard_normal(30)
    return ParameterSweep(
        experiment="motor", points=grid(["period=25ms,50ms"]), columns=(columns(drawn), columns(drawn + 0.1 + noise)),
        quantities=(SSE,),
    )  # fmt: skip


def test_paired_differences_tell_points_apart_that_overlap(sweep: ParameterSweep) -> None:
    first, second = sweep.intervals("sse")
    assert first.high > second.low, "the intervals of the points overlap"
    gap = sweep.difference(1, 0, "sse")
    assert gap.low > 0.09 and gap.high < 0.11
    assert sweep.answer("sse").startswith("best point: period=25 ms; ") and "1 of 1 other points differ" in sweep.answer("sse")


def test_a_share_loop_begins_at_0_and_ends_at_1_over_the_whole_axis() -> None:
    low, high = _shares({"low": np.array([1.0, 1.0, 2.0]), "high": np.array([2.0, 4.0, np.nan]), "none": np.array([np.nan])})
    assert ([*low.x], [*low.y]) == ([1.0, 2.0, 4.0], pytest.approx([2 / 3, 1.0, 1.0]))
    assert ([*high.x], [*high.y]) == ([1.0, 2.0, 4.0], [0.0, 0.5, 1.0])
