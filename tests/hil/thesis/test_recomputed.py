"""Rows on gains of the printed corollaries themselves, on Markov approximations, longer delays, and integral action."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from design.as_printed.examples import chapter2_process, chapter3_process
from hil.thesis.chapter2_feasibility import MARKOV, markov, markov_approximation, mean_sojourns
from hil.thesis.chapter3_partitions import FURTHER
from hil.thesis.chapter3_partitions import further as delays
from hil.thesis.chapter4 import OTHER_FAULTS, other_faults
from hil.thesis.chapter4_simulations import GAMMA, RECOMPUTED, recomputed, simulate
from hil.thesis.chapter7_friction import INTEGRAL, integral_action
from hil.thesis.statements import judge
from tests.hil.thesis.judging import assert_every_number_decides


def _quiet(text: str, done: int = 0, total: int = 0, /) -> None:
    pass


def test_the_mean_sojourn_is_that_of_the_survival_function() -> None:
    """Of the ramp (2.26): the integral of exp(-H) with H' = min(max(h, 0.1), 4.6)."""
    h = np.linspace(0.0, 20.0, 200_001)
    rate = np.clip(h, 0.1, 4.6)
    survival = np.exp(-np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(h))]))
    assert mean_sojourns(chapter2_process()) == pytest.approx([float(np.trapezoid(survival, h))] * 2, rel=1e-4)
    found = markov_approximation(chapter2_process())
    assert mean_sojourns(found) == pytest.approx(mean_sojourns(chapter2_process()), rel=1e-4)
    with pytest.raises(ValueError, match="3 modes"):
        markov_approximation(chapter3_process())


def test_integral_action_removes_the_steady_state_error() -> None:
    values: dict[str, Any] = dict(integral_action(_quiet))
    rows = judge(INTEGRAL, values)
    assert [row.verdict for row in rows] == ["reproduced"]
    assert_every_number_decides(rows)


def test_gains_of_the_corollaries_are_those_of_their_sections(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under one bound, in the place of all three, and by 10 runs."""
    for name, value in (("BOUNDS", (50.0,)), ("RUNS", 10), ("simulate", partial(simulate, runs=10))):
        monkeypatch.setattr(f"hil.thesis.chapter4_simulations.{name}", value)
    found = recomputed(_quiet)
    rows = judge(RECOMPUTED, {name: numbers if name == "size" else 3 * numbers for name, numbers in found.items()})
    assert [row.verdict for row in rows] == ["not reproduced", "not reproduced", "reproduced", "not reproduced"]
    assert found["ratios"][0] == pytest.approx([0.029, 0.029], rel=0.1) and found["levels"][0][0] < GAMMA


@pytest.mark.slow
@pytest.mark.parametrize(
    ("compute", "statements", "verdicts"),
    [
        (markov, MARKOV, ["reproduced"]),
        (delays, FURTHER, ["not reproduced", "reproduced"]),
        (recomputed, RECOMPUTED, ["not reproduced", "not reproduced", "reproduced", "undecided"]),
        (other_faults, OTHER_FAULTS, ["reproduced", "reproduced"]),
    ],
)
def test_rows_hold_and_turn(compute: Any, statements: Any, verdicts: list[str]) -> None:
    rows = judge(statements, compute(_quiet))
    assert [row.verdict for row in rows] == verdicts
    assert_every_number_decides(rows)
