"""The report of several sensor nodes: which node sent, the age of each node's newest sample, the load."""

from __future__ import annotations

import numpy as np

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.pages.html.figures import Figure, Table
from hil.pages.run_page import render_report
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
