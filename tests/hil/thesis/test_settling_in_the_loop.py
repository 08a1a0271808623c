"""Settling times (2.28) of the emulated loop of Chapter 2."""

from __future__ import annotations

import numpy as np
import pytest

from hil.thesis.chapter2_runs import IN_THE_LOOP, comparison, settling_time
from hil.thesis.chapter2_runs import settled_on_the_rig as settled
from hil.thesis.statements import judge
from tests.hil.thesis.judging import assert_every_number_decides


def test_settling_begins_after_the_last_sample_outside_the_band() -> None:
    time_s = 0.5 * np.arange(6)
    x = np.array([100.0, 1.0, 2.0, 1.0, 0.0, 0.0])[:, None] * [0.6, 0.8]
    assert settling_time(time_s, x) == 1.5
    assert settling_time(time_s, 0 * x) == 0.0
    assert settling_time(time_s, np.ones((6, 2))) == 3.0  # never: the end of the run


def test_the_gains_of_the_reference_run_and_settle_later() -> None:
    published, reference = (settled(name, (0, 1), 12.0) for name in ("smjls-robust-published", "smjls-robust-reference"))
    assert (published < reference).all() and (published < 5.0).all()


@pytest.mark.parametrize(("slower", "verdict"), [(7.0, "reproduced"), (0.0, "not reproduced"), (-7.0, "not reproduced")])
def test_the_rows_follow_the_times(slower: float, verdict: str) -> None:
    times = 3.0 + np.random.default_rng(0).random(40)
    rows = judge(IN_THE_LOOP, comparison({"published": times, "ours": times[::-1], "reference": times + slower}))
    assert [row.verdict for row in rows] == [verdict] * 2
    assert_every_number_decides(rows)
