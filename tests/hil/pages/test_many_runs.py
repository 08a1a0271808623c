"""Pages of many runs: what was computed is marked, the best point is said, an outlier presses nothing onto the axis."""

from __future__ import annotations

import numpy as np
import pytest

from hil.measure import Quantity
from hil.pages.many_runs import compare_page, parameter_page
from hil.sweeps.comparison import Comparison
from hil.sweeps.parameters import ParameterSweep
from hil.sweeps.points import grid, latin_hypercube

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


@pytest.mark.parametrize("ranges", [["period=10ms:50ms"], ["period=10ms:50ms", "plant.gain=100:200"]])
def test_points_of_a_range_are_drawn_over_each_key_and_joined_by_nothing(ranges: list[str]) -> None:
    found = tuple(columns(np.full(4, 10.0 + i)) for i in range(5))
    page = parameter_page(ParameterSweep(experiment="motor", points=latin_hypercube(ranges, 5), columns=found, quantities=(SSE,)))
    assert page.count('"style":"circles"') == len(ranges) and '"style":"line"' not in page and '"xLabel":"period (ms)"' in page


@pytest.mark.parametrize(("values", "scale"), [([-3.0, 1.0, 2.0, 900.0], '"yAsinh":'), ([1.0, 2.0, 3.0, 900.0], '"yLog":true')])
def test_a_point_far_off_presses_no_other_onto_the_axis(values: list[float], scale: str) -> None:
    points = grid(["plant.gain=" + ",".join(str(100 + i) for i in range(len(values)))])
    found = tuple(columns(value + 0.01 * np.arange(5.0)) for value in values)
    page = parameter_page(ParameterSweep(experiment="motor", points=points, columns=found, quantities=(SSE,)))
    assert scale in page.replace('"yAsinh":null', "") and "The axis is" in page


def test_the_page_of_a_sweep_opens_with_its_answer_and_marks_what_was_computed(sweep: ParameterSweep) -> None:
    page = parameter_page(sweep)
    assert page.index(">Answer<") < page.index("best point: period=25 ms") < page.index("difference to the best point (rad² s)")
    assert '"marked":true' in page and '"xTicks":[25.0,50.0]' in page


@pytest.mark.parametrize(("outlier", "logarithmic"), [(400.0, True), (12.0, False)])
def test_an_experiment_far_off_takes_a_logarithmic_axis(outlier: float, logarithmic: bool) -> None:
    drawn = 10.0 + np.random.default_rng(0).random(30)
    values = {"a": columns(drawn), "b": columns(drawn + outlier)}
    page = compare_page(Comparison(runs=30, values=values, quantities=(SSE,)))
    assert ('"xLog":true' in page) is logarithmic
    signed = {"a": columns(drawn - 10.5), "b": columns(drawn - outlier)}
    page = compare_page(Comparison(runs=30, values=signed, quantities=(SSE,)))
    assert ('"xAsinh":null' not in page) is logarithmic and '"xLog":true' not in page
