"""Chapter 5: verdicts with the numbers that they rest on, and verdicts that turn with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from design.as_printed.historical_data import historical_gains, newest_gains
from design.historical_data.block_diagonal import tangent_scheme
from design.historical_data.information import round_robin
from design.historical_data.lifted_loop import DelayedPlant
from design.historical_data.matched_peak import PeakMatch
from design.historical_data.orders import OrderCost
from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.reproduce import chapters
from hil.reproduce.chapter5 import equation_rows as equations
from hil.reproduce.chapter5.further import (
    Printed,
    any_order_row,
    delay_row,
    further_rows,
    noise_row,
    order_row,
    peak_row,
    tangent_row,
    variant_plant,
)
from hil.reproduce.chapter5.numbers import cost_rows, especially_row, figures, published_plant, theorem_rows
from hil.reproduce.judgement import Row
from hil.session import simulate

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


def test_rows_beyond_the_chapter_turn_with_their_numbers() -> None:
    prompt, late = (round_robin(4, buffer=3, memory=6, delay=delay).mask() for delay in (0, 1))
    assert delay_row(prompt, late).verdict == "claim false"
    slow = prompt.copy()
    slow[:, 0] = False
    assert delay_row(prompt, slow).verdict == "reproduced"
    printed, gains = Printed("(5.16)", 221.1, 2.594), np.zeros((4, 1, 1, 4))
    assert peak_row(printed, PeakMatch(0.3, gains, 2.57, 187.2)).verdict == "reproduced"
    for worse in ((2.60, 187.2), (2.57, 191.0)):
        assert peak_row(printed, PeakMatch(0.3, gains, *worse)).verdict == "not reproduced"
    assert (noise_row(1.0, 2.0, 3.0).verdict, noise_row(2.0, 1.0, 3.0).verdict) == ("reproduced", "not reproduced")
    first, second = OrderCost((0, 2, 1), gains, 1.0), OrderCost((0, 1, 2), gains, 1.004)
    assert order_row([first, second]).verdict == "reproduced"
    assert order_row([first, second._replace(cost=1.006)]).verdict == "not reproduced"
    variant, x0 = variant_plant(PLANT), np.array([-4.0, 3.0, -6.0, 1.0])
    proof = tangent_scheme(variant, round_robin(4, buffer=3).mask(), x0, iterations=0)
    assert tangent_row(variant, proof, x0).verdict == "not reproduced"
    assert tangent_row(variant, proof._replace(bounds=(14.57,)), x0).verdict == "reproduced"


def test_every_equation_has_a_row_and_every_row_turns_with_its_number() -> None:
    """Each row is judged as it is, and once more with one thing wrong: a node, a gain, a weight, an entry, a path."""
    said = verdicts(equations.equation_rows(PLANT))
    claims = {item for item in said if item.startswith(("the controller has 24", "Remark 5.3"))}
    assert {item for item, verdict in said.items() if verdict != "reproduced"} == claims and len(said) == 11
    assert {said[item] for item in claims} == {"claim false"}
    info, wrong = round_robin(4, buffer=3), "not reproduced"
    assert equations.schedule_row([0, 1, 2, 3, 0]).verdict == "reproduced"
    assert equations.schedule_row([0, 1, 3, 3, 0]).verdict == wrong
    loop = compose(load_experiment("multisensor-published", ["duration=1"]))
    x = np.column_stack([simulate(loop, 0).arrays["/plant/state"][f"x{i + 1}"] for i in range(4)])
    assert equations.loop_row(PLANT, historical_gains(), x).verdict == "reproduced"
    assert equations.loop_row(PLANT, np.roll(historical_gains(), 1, axis=0), x).verdict == wrong
    assert equations.rig_cost_row(220.3).verdict == equations.rig_cost_row(None).verdict == wrong
    assert equations.memory_row(replace(info, memory=6)).verdict == wrong
    assert equations.mask_row(info.mask()[1]).verdict == wrong
    assert equations.mask_row(round_robin(4, buffer=2, memory=5).mask()[2]).verdict == wrong
    assert equations.earlier_row(round_robin(4, buffer=5)).verdict == wrong
    assert equations.shape_row(np.zeros((4, 6, 4, 1))).verdict == "reproduced"
    assert equations.shape_row(np.zeros((4, 5, 1, 4))).verdict == "claim false"
    assert equations.path_row(np.full((4, 4), 0.25)).verdict == "reproduced"
    assert equations.plant_row(replace(PLANT, weight=np.eye(4))).verdict == wrong
    assert equations.conventional_row(PLANT, -9.0 * newest_gains()).verdict == wrong
    assert equations.random_row(1.01, 2.3).verdict == equations.random_row(0.7, 2.49).verdict == wrong
    assert especially_row(np.array([0.5, 0.3, 0.9, 0.2])).verdict == "reproduced"
    assert especially_row(np.array([0.5, 0.3, 0.9, 0.6])).verdict == wrong


@pytest.mark.slow
def test_every_row_beyond_the_chapter_is_as_said() -> None:
    """A bound of J for any order of the sensors, least J at the published peak inputs, the tangent scheme's bound."""
    said = verdicts(further_rows(PLANT, lambda text, done=0, total=0, /: None))
    assert sorted(said.values()) == ["claim false"] + ["reproduced"] * 7
    assert any_order_row(PLANT, newest_gains(), np.array([-4.0, 3.0, -6.0, 1.0])).verdict == "reproduced"
