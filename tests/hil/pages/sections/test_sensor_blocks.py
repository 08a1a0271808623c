"""The report of several sensor nodes: which node sent, the age of each node's newest sample, the load."""

from __future__ import annotations

import numpy as np
import pytest

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.measure.network_paths import network_paths
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.pages.html.figures import Figure, Table
from hil.pages.run_page import render_report
from hil.pages.sections.statistics import network_table
from hil.pages.sections.theory import section as theory_section
from hil.pages.sections.traffic import newest_ages
from hil.pages.sections.traffic import sensor_nodes as nodes_section
from hil.runtime.virtual import simulate


def test_who_spoke_and_how_old_each_newest_sample_is() -> None:
    loop = compose(load_experiment("multisensor-published", ["duration=1", "network.sc.max_age=1"]), certify=False)
    view = view_of(simulate(loop, 0), loop.experiment)
    spoke, ages, table = nodes_section(view).blocks  # type: ignore[union-attr]
    assert isinstance(spoke, Figure) and isinstance(ages, Figure) and isinstance(table, Table)
    assert spoke.series[0].y.tolist() == [(k + 1) % 4 for k in range(20)]
    draws = view.run.arrays["/network/sc"]
    np.testing.assert_array_equal(newest_ages(draws, 0, 8), [np.nan, np.nan, np.nan, 0, 1, 2, 3, 0])
    assert [row[:4] for row in table.rows][2] == ["third", "x3", 5, 0]
    page = render_report(view)
    assert "Which node sent" in page and "Network load" in page


def test_two_nodes_of_a_motor_are_drawn_with_what_theory_says_of_them() -> None:
    law = "controller={kind='local', gain=[[-0.05, -0.006]]}"
    loop = compose(load_experiment("dc-motor-two-nodes", ["duration=1", "reference.0.at=0.1", law]))
    view = view_of(simulate(loop, 0), loop.experiment)
    spoke, ages, table = nodes_section(view).blocks  # type: ignore[union-attr]
    assert isinstance(spoke, Figure) and isinstance(ages, Figure) and isinstance(table, Table)
    assert set(spoke.series[0].y.tolist()) == {0.0, 1.0} and [series.label for series in ages.series] == ["angle", "speed"]
    for series in ages.series:
        assert set(series.y[np.isfinite(series.y)].tolist()) == {0.0, 1.0}
    assert [row[:2] for row in table.rows] == [["angle", "angle"], ["speed", "speed"]]
    tested = network_table(summarise(view)["network"], network_paths(view)).rows
    assert [row[:2] for row in tested] == [["Angle to controller", "markov law"], ["Speed to controller", "markov law"], [
        "Controller to actuator", "markov law"]]  # fmt: skip
    section = theory_section(view)
    assert section is not None
    figure, sums = section.blocks  # the speed follows no reference: it has no error
    assert isinstance(figure, Figure) and isinstance(sums, Table) and "angle" in figure.title
    assert len(figure.bands) == 2 and np.isfinite(figure.bands[0].upper).all()
    assert (figure.bands[0].upper - figure.bands[0].lower).max() > 0.0
    assert sums.columns[0] == "squared tracking error (rad² s)"
    assert sums.rows[0][3] == pytest.approx(summarise(view)["metrics"]["sse"], rel=1e-9)


def test_a_run_of_one_node_has_no_such_section() -> None:
    loop = compose(load_experiment("dc-motor-hinf", ["duration=1"]), certify=False)
    assert nodes_section(view_of(simulate(loop, 0), loop.experiment)) is None
