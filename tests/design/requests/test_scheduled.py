"""State feedback scheduled by mode and sojourn time, as it runs in a loop."""

from __future__ import annotations

import numpy as np
import pytest

from design.as_printed import chapter2_gain
from design.controllers import LoopModel
from design.controllers.scheduled_gain import constant_gain
from design.errors import FieldError
from design.requests.scheduled import Scheduled, scheduled_of
from design.requests.tracking import DesignTask


def model(p: int = 3) -> LoopModel:
    return LoopModel(A=np.eye(2), B=np.ones((2, 1)), C=np.zeros((p, 2)), period_s=0.1, tau_max=2, d_max=0)


def test_gain_follows_the_mode_and_the_time_since_it_was_seen_to_change() -> None:
    gain = chapter2_gain()  # sections at 0 and 0.8326 s
    running = scheduled_of(gain).start(model())
    x = (1.0, -2.0)
    for k in range(30):
        mode = 0 if k < 20 else 1
        (row,) = running.rows(k, 0, (*x, mode + 1.0), (0.0, 0.0, 0.0))
        h = 0.1 * (k if k < 20 else k - 20)
        assert row == pytest.approx(tuple(gain.at(mode, h) @ np.array(x)))


def test_a_sum_rounds_after_every_term_whatever_python_it_runs_on() -> None:
    gain = constant_gain(np.ones((1, 1, 3)))
    loop = LoopModel(A=np.eye(3), B=np.ones((3, 1)), C=np.zeros((4, 3)), period_s=0.1, tau_max=0, d_max=0)
    ((row,),) = scheduled_of(gain).start(loop).rows(0, 0, (1.0, 1e16, -1e16, 1.0), (0.0,) * 4)
    assert row == 0.0  # `sum` gives 1.0 from Python 3.12 on


def test_sojourn_clock_counts_from_the_sample_not_from_its_arrival() -> None:
    gain = chapter2_gain()
    running = scheduled_of(gain).start(model())
    running.rows(10, 2, (1.0, 0.0, 1.0), (0.0,) * 3)  # the mode was seen in the sample of slot 8
    (row,) = running.rows(17, 0, (1.0, 0.0, 1.0), (0.0,) * 3)  # 0.9 s later: second section
    assert row[0] == gain.gain[0, 1, 0, 0]


def test_mode_that_no_gain_knows_takes_the_nearest() -> None:
    running = scheduled_of(chapter2_gain()).start(model())
    assert running.rows(0, 0, (1.0, 0.0, 9.0), (0.0,) * 3) == running.rows(1, 0, (1.0, 0.0, 2.0), (0.0,) * 3)


def test_gains_that_do_not_fit_the_plant_are_refused() -> None:
    with pytest.raises(ValueError, match=r"gain: 1 x 2 matrices, expected 1 x 4: inputs of the plant"):
        scheduled_of(chapter2_gain()).start(model(p=5))
    with pytest.raises(ValueError, match="gain: expected"):
        Scheduled(gain=((((1.0,), (1.0, 2.0)),),), starts_s=((0.0,),))


def test_a_design_without_chains_names_its_field_and_what_keeps_them_away() -> None:
    model = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.1, tau_max=0, d_max=0)
    with pytest.raises(FieldError, match="a law states none") as error:
        DesignTask(model=model, sc=None, ca=None).chains  # noqa: B018
    assert error.value.field == "kind"
    with pytest.raises(FieldError, match="a design needs a chain of ages on both links, but packets are reordered"):
        DesignTask(model=model, sc=None, ca=None, chainless="packets are reordered").chains  # noqa: B018
