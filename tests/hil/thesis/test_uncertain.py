"""Chapter 7's rows on uncertain plants."""

from __future__ import annotations

import pytest

from hil.thesis.chapter7_designs import UNCERTAIN, uncertain
from hil.thesis.statements import judge
from tests.hil.thesis.judging import assert_every_number_decides


@pytest.mark.slow
def test_gains_for_uncertain_plants_bear_more_and_the_rows_turn() -> None:
    """Of small loops in `tests/design/tracking/test_robust_synthesis.py`, of this motor in `tests/hil/design_questions/`."""
    rows = judge(UNCERTAIN, uncertain(lambda text, done=0, total=0, /: None))
    assert [row.verdict for row in rows] == ["reproduced", "reproduced"]
    assert_every_number_decides(rows)
