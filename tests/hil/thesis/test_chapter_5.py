"""Chapter 5: verdicts with the numbers that they rest on, and verdicts that turn with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from design.as_printed.chapters_5_and_6 import historical_gains, newest_gains
from design.historical_data import DelayedPlant, close
from design.historical_data.block_diagonal import BlockDiagonalProof, largest_eigenvalue
from design.historical_data.guaranteed_cost import cost, start_at, stationary_cost
from design.historical_data.least_cost import OrderCost, PeakMatch, cyclic_orders
from design.historical_data.sensor_schedule import mask_of, round_robin
from hil.compose import compose
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from hil.thesis import chapter5_equations as equations
from hil.thesis.chapter5 import GAINS, THEOREM, delay, further, gains_numbers, published_plant, theorem_numbers, variant_plant
from hil.thesis.statements import Statement, judge
from tests.hil.thesis.judging import assert_every_number_decides

PLANT = published_plant()
X0 = np.array([-4.0, 3.0, -6.0, 1.0])
BETTER = "5.5: the proposed controller outperforms the conventional technique"
BOUND = "Theorem 5.1: a bound V(x(0)) = 616.5 for Section 5.4"


def verdicts(statements: Sequence[Statement], values: Mapping[str, Any]) -> dict[str, str]:
    rows = judge(statements, values)
    assert_every_number_decides(rows)
    return {row.item: row.verdict for row in rows}


def test_verdicts_turn_with_their_numbers() -> None:
    """Gains 2 % larger cost another J; (5.16) is better than nothing; with A(3,3) = 0.6 the theorem is not refuted."""
    turned = verdicts(GAINS, gains_numbers(PLANT, historical_gains() * 1.02, newest_gains()))
    assert turned["J of (5.16)"] == "not reproduced"
    none = verdicts(GAINS, gains_numbers(PLANT, historical_gains(), 0.0 * newest_gains()))
    assert none[BETTER] == "reproduced"
    stable = DelayedPlant(A=PLANT.A - 0.5 * np.diag([0, 0, 1, 0]), delayed=PLANT.delayed / 4, B=PLANT.B, weight=PLANT.weight)
    assert verdicts(THEOREM, theorem_numbers(stable))[BOUND] == "reproduced"


def test_what_is_wrong_in_a_loop_or_a_mask_is_counted() -> None:
    """A node out of turn, gains of another phase, the mask of another node, or of packets with fewer samples or more."""
    mask = mask_of(round_robin(4, buffer=3))
    assert equations.wrong_turns([0, 1, 2, 3, 0]) == 0 and equations.wrong_turns([0, 1, 3, 3, 0]) > 0
    loop = compose(load_experiment("multisensor-published", ["duration=1"]))
    x = np.column_stack([simulate(loop, 0).arrays["/plant/state"][f"x{i + 1}"] for i in range(4)])
    assert equations.loop_difference(PLANT, np.roll(historical_gains(), 1, axis=0), x) > 1e-5
    assert equations.mask_numbers(mask[2], 3) == {"differ": 0, "free": 15, "known": 3, "late": 0}
    assert equations.mask_numbers(mask[1], 3)["differ"] > 0
    assert equations.mask_numbers(mask_of(round_robin(4, buffer=2), 5)[2], 2)["free"] < 15
    assert equations.mask_numbers(mask_of(round_robin(4, buffer=5))[2][:6], 5)["late"] > 0


def test_remark_5_2_uses_what_a_delay_has_not_brought_and_the_shifted_mask_does_not() -> None:
    """The newest sample is used again at ages 1 and 2, in each of four phases, before a delay of one slot has brought it."""
    prompt, late = mask_of(round_robin(4, buffer=3), 6), mask_of(round_robin(4, buffer=3, delay=1))
    assert delay(prompt, late) == {"missing": 8, "shifted": 0}
    assert delay(prompt, prompt) == {"missing": 0, "shifted": 8}
    assert delay(prompt, np.roll(prompt, 1, axis=0))["shifted"] == 40


def test_rows_beyond_the_chapter_say_what_was_found_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """With answers in the place of minutes of search; costs, noise and the inequality are computed of them."""
    asked: list[tuple[Any, ...]] = []
    mask, gains = mask_of(round_robin(4, buffer=3)), (historical_gains(), newest_gains())
    J = [cost(close(PLANT, each), start_at(X0, 4, 0)) for each in gains]
    zero, P = np.zeros((4, 4, 1, 4)), 100.0 * np.eye(4)
    proof = BlockDiagonalProof(P, np.repeat(np.eye(4)[None], PLANT.memory, axis=0), zero, (40.0, 30.0, 25.0))

    def matched(plant: DelayedPlant, mask: Any, x0: Any, phase: int, peak: float) -> PeakMatch:
        asked.append((plant is PLANT, mask.sum(), tuple(x0), phase))
        return PeakMatch(0.5, zero, peak - 0.25, 10.0)

    orders = [OrderCost((0, 2, 1, 3), gains[1], 2.0), OrderCost((0, 1, 2, 3), gains[0], 2.5)]
    for name, answer in (
        ("match_peak", matched), ("orders_by_cost", lambda plant, nodes, start: orders),
        ("common_bound", lambda loop, start: (float(start @ start), P)), ("tangent_scheme", lambda *given: proof),
        ("cone_complementarity", lambda plant, mask, x0, bound: proof._replace(bounds=(bound,))),
    ):  # fmt: skip
        monkeypatch.setattr(f"hil.thesis.chapter5.{name}", answer)
    steps: list[str] = []
    found = further(PLANT, lambda text, done=0, total=0, /: steps.append(text))
    assert steps[0] == "input weight" and len(steps) == 4
    assert asked == [(True, mask.sum(), tuple(X0), 0)] * 2 and found["missing"] > 0 == found["shifted"]
    assert found["J"] == pytest.approx(J) and found["share"] == pytest.approx([10.0 / each for each in J])
    assert found["peaks"] == pytest.approx([15.93, 2.59], rel=2e-3) or found["peaks"] == pytest.approx([2.59, 15.93], rel=2e-3)
    assert found["more"] == pytest.approx([-0.25, -0.25]) and found["order"] == 1.25
    assert found["orders"] == "1-3-2-4 2.0000, 1-2-3-4 2.5000"
    noise = [stationary_cost(PLANT, each, 0.1) for each in (*gains, gains[0])]
    assert found["noise"] == pytest.approx(noise) and found["bound"] == X0 @ X0
    turned = [cost(close(PLANT, gains[0][list(order)]), start_at(X0, 4, 0)) for order in cyclic_orders(4)]
    assert found["worst"] == pytest.approx(max(turned)) and len(turned) == 6
    variant = variant_plant(PLANT)
    worst = max(cost(close(variant, zero), start_at(X0, 4, phase)) for phase in range(4))
    numbers = {"first": 40.0, "bound": 25.0, "steps": 2, "saved": 15.0, "worst": worst / 25.0}
    assert found["tangent"] == pytest.approx(numbers | {"eigenvalue": largest_eigenvalue(variant, zero, P, proof.Q)})
    assert (found["cone"]["first"], found["cone"]["bound"], found["cone"]["steps"]) == (14.8, 14.8, 0)
