"""The Smith predictor: the delay of the measurement is taken out by the model, so that a right model leaves no bias."""

from __future__ import annotations

import numpy as np
import pytest

from design.controllers import LoopModel
from design.controllers.smith import Smith


def model(tau_max: int) -> LoopModel:
    a = np.array([[0.9, 0.1], [0.0, 0.7]])
    return LoopModel(A=a, B=np.array([[0.0], [1.0]]), C=np.array([[1.0, 0.0]]), period_s=0.1, tau_max=tau_max, d_max=1)


@pytest.mark.parametrize("tau", [1, 3])
def test_a_delayed_sample_of_a_plant_that_is_its_model_gives_the_rows_of_a_prompt_one(tau: int) -> None:
    loop = model(tau)
    prompt, delayed = (Smith(gain=((-0.3,),)).start(loop) for _ in range(2))
    x, outputs = np.zeros(2), [0.0] * (tau + 1)
    for k in range(30):
        outputs.append(float(x[0]))
        rows = prompt.rows(k, 0, (outputs[-1],), (1.0,))
        assert delayed.rows(k, tau, (outputs[-1 - tau],), (1.0,)) == pytest.approx(np.array(rows), abs=1e-12)
        x = loop.A @ x + loop.B @ np.array(rows[0])
    assert abs(outputs[-1] - outputs[-1 - tau]) > 1e-3  # it still moves: an older sample is another one


@pytest.mark.filterwarnings("error")
def test_a_loop_that_diverges_is_no_warning_and_a_lost_slot_passes_for_the_model() -> None:
    loop = model(1)
    every, some = (Smith(gain=((-0.3,),)).start(loop) for _ in range(2))
    every.rows(0, 0, (1.0,), (0.0,))
    some.rows(0, 0, (1.0,), (0.0,))
    once = some.rows(3, 0, (0.5,), (0.0,))
    assert once != every.rows(1, 0, (0.5,), (0.0,))  # two slots more have passed
    for k in range(4, 10):
        assert len(some.rows(k, 1, (-1e308 if k % 2 else 1e308,), (1e308,))) == loop.d_max + 1


def test_each_row_is_for_the_model_as_many_slots_ahead() -> None:
    """x(k+1) = 0.5 x(k) + u of gain -0.2, at rest: row d + 1 sees what the rows before it did to the model."""
    one = np.eye(1)
    model = LoopModel(A=0.5 * one, B=one, C=one, period_s=0.1, tau_max=0, d_max=3)
    rows = Smith(gain=((-0.2,),)).start(model).rows(0, 0, (1.0,), (0.0,))
    x, expected = 0.0, []
    for _ in range(4):
        expected.append((-0.2 * (x + 1.0),))  # what the model lacks of the measurement is taken to stay
        x = 0.5 * x + expected[-1][0]
    assert np.allclose(rows, expected) and len({row[0] for row in expected}) == 4
