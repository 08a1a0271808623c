"""Chapter 5: verdicts with the numbers that they rest on, and verdicts that turn with them."""

from __future__ import annotations

import numpy as np

from design.as_printed.historical_data import historical_gains, newest_gains
from design.historical_data.lifted_loop import DelayedPlant
from hil.reproduce import chapters
from hil.reproduce.chapter5.numbers import cost_rows, figures, published_plant, theorem_rows
from hil.reproduce.judgement import Row

PLANT = published_plant()
BETTER = "5.5: the proposed controller outperforms the conventional technique"
BOUND = "Theorem 5.1: a bound V(x(0)) = 616.5 for Section 5.4"


def verdicts(rows: list[Row]) -> dict[str, str]:
    return {row.item: row.verdict for row in rows}


def test_the_printed_numbers_and_claims() -> None:
    assert "ch5" in chapters()
    rows = cost_rows(PLANT, historical_gains(), newest_gains())
    found = verdicts(rows)
    assert found["J of (5.16)"] == found["I(0) of J = 220.2"] == found["(5.16): zero-element constraints (5.8)"] == "reproduced"
    assert found[BETTER] == "claim false"
    theorem = verdicts(theorem_rows(PLANT))
    assert theorem[BOUND] == theorem["(5.15): J < V(x(0)) with any history"] == "claim false"


def test_verdicts_turn_with_their_numbers() -> None:
    """Gains 2 % larger cost another J; (5.16) is better than nothing; with A(3,3) = 0.6 the theorem is not refuted."""
    turned = verdicts(cost_rows(PLANT, historical_gains() * 1.02, newest_gains()))
    assert turned["J of (5.16)"] == "not reproduced"
    none = verdicts(cost_rows(PLANT, historical_gains(), 0.0 * newest_gains()))
    assert none[BETTER] == "reproduced"
    stable = DelayedPlant(A=PLANT.A - 0.5 * np.diag([0, 0, 1, 0]), delayed=PLANT.delayed / 4, B=PLANT.B, weight=PLANT.weight)
    assert verdicts(theorem_rows(stable))[BOUND] == "reproduced"


def test_the_figures_are_runs_on_the_rig() -> None:
    part = figures()
    assert [panel.title[:3] for panel in part.figures[0].panels] == ["5.3", "5.4"]
    assert {row.verdict for row in part.rows} == {"reproduced"}
