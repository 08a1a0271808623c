"""The curves of the delays over time are of what the law drew and of what was measured."""

from __future__ import annotations

import numpy as np

from hil.measure.view import view_of
from hil.pages.html.figures import Figure
from hil.pages.sections.time_panels import delays
from tests.hil.pages.runs import run_of


def test_a_delay_is_drawn_in_the_slots_in_which_it_is_known() -> None:
    run = run_of("dc-motor-hinf", 'duration="4 s"')
    arriving, acting, _ = delays(view_of(run)).blocks
    for panel, side in ((arriving, "sc"), (acting, "ca")):
        assert isinstance(panel, Figure)
        (drawn, measured), draws = panel.series, run.arrays[f"/network/{side}"]
        ages = {int(record["slot"]): int(record["age"]) for record in draws if record["mode"] >= 0}
        assert [ages[round(at / 0.05)] for at in drawn.x] == drawn.y.tolist() and set(drawn.y) == set(ages.values()) >= {0, 1}
        assert {0, 1} <= set(measured.y[np.isfinite(measured.y)])
