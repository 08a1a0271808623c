"""Gain tables in the loop, and the integral of the error."""

from __future__ import annotations

import numpy as np
import pytest

from design.controllers import LoopModel, SendAll, nested
from design.controllers.contract import KnownInBatch
from design.errors import FieldError

INTEGRATOR = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.1, tau_max=0, d_max=0)


def test_the_integral_holds_the_errors_of_earlier_slots_only() -> None:
    """u(k) = -2 e(k) + 10 sum over j < k of e(j): the error of slot k enters the integral in slot k + 1."""
    gains = nested(np.array([[[[-2.0, 10.0]]]]))
    running = SendAll(gains=gains, integral=True, selection="constant").start(INTEGRATOR)
    answers = [running.rows(k, 0, (e,), (0.0,))[0][0] for k, e in enumerate((1.0, 0.5, 0.25))]
    assert answers == [-2.0, -1.0 + 10.0, -0.5 + 15.0]


def test_a_state_of_its_own_goes_on_by_the_gains_of_the_age() -> None:
    """xi(k+1) = e(k) + xi(k)/2 at age 0 and e(k) at age 1; u = -e + 4 xi, and -2 e + 8 xi. Alone and in two runs at once."""
    loop = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.1, tau_max=1, d_max=0)
    gains = nested(np.array([[[[-1.0, 4.0]]], [[[-2.0, 8.0]]]]))
    own = SendAll(gains=gains, state_gains=(((1.0, 0.5),), ((1.0, 0.0),)), selection="constant")
    errors, ages, answers = (1.0, 0.5, 0.25, 1.0), (0, 1, 0, 1), (-1.0, -1.0 + 8.0, -0.25 + 4 * 0.5, -2.0 + 8 * 0.5)
    running, many = own.start(loop), own.start_batch(loop, 2)
    assert many is not None
    for k, (e, tau, u) in enumerate(zip(errors, ages, answers)):
        assert running.rows(k, tau, (e + 3.0,), (3.0,)) == ((u,),)  # type: ignore[union-attr,call-arg,arg-type]
        known = KnownInBatch(np.ones(2, dtype=bool), np.full((1, 2), tau, dtype=np.intp), np.array([[e, -e]]), (0.0,))
        assert many.rows(k, known)[0, 0].tolist() == [u, -u]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"state_gains": (((1.0, 0.5), (1.0, 0.5)),)}, r"state_gains: shape \[1, 2, 2\], expected \[1\]\[c\]\[2\]"),
        ({"state_gains": (((1.0,),),)}, r"state_gains: shape \[1, 1, 1\], expected"),
        ({"state_gains": (((1.0, 0.5),), ((1.0, 0.5),))}, r"state_gains: shape \[2, 1, 2\], expected"),
    ],
)
def test_gains_of_a_state_that_do_not_fit_are_refused(fields: dict[str, object], said: str) -> None:
    with pytest.raises(FieldError, match=said):
        SendAll(gains=nested(np.array([[[[-2.0, 10.0]]]])), selection="constant", **fields)  # type: ignore[arg-type]


def test_a_clamped_integral_stays_within_its_limit_and_comes_back_at_once() -> None:
    """The sum would be 1, 2, 3, 2: clamped at 1.5 it is 1, 1.5, 1.5, 0.5. Alone and in two runs at once, of either sign."""
    clamped = SendAll(gains=nested(np.array([[[[-2.0, 10.0]]]])), integral=True, integral_limit=(1.5,), selection="constant")
    errors, sums = (1.0, 1.0, 1.0, -1.0, 0.0), (0.0, 1.0, 1.5, 1.5, 0.5)
    for sign in (1.0, -1.0):
        running = clamped.start(INTEGRATOR)
        answers = [running.rows(k, 0, (sign * e,), (0.0,))[0][0] for k, e in enumerate(errors)]  # type: ignore[union-attr,call-arg,arg-type]
        assert answers == [sign * (-2.0 * e + 10.0 * s) for e, s in zip(errors, sums)]
    many = clamped.start_batch(INTEGRATOR, 2)
    assert many is not None
    for k, (e, s) in enumerate(zip(errors, sums)):
        known = KnownInBatch(np.ones(2, dtype=bool), np.zeros((1, 2), dtype=np.intp), np.array([[e, -e]]), (0.0,))
        assert many.rows(k, known)[0, 0].tolist() == [-2.0 * e + 10.0 * s, 2.0 * e - 10.0 * s]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"integral": False, "integral_limit": (1.0,)}, "needs integral = true"),
        ({"integral": True, "integral_limit": (0.0,)}, "expected a finite number above 0"),
        ({"integral": True, "integral_limit": (1.0, 1.0)}, "length 2, expected 1: one for each output"),
    ],
)
def test_a_limit_that_clamps_nothing_is_refused(fields: dict[str, object], said: str) -> None:
    with pytest.raises(FieldError, match=said):
        SendAll(gains=nested(np.array([[[[-2.0, 10.0]]]])), selection="constant", **fields).start(INTEGRATOR)  # type: ignore[arg-type]


def test_a_tau_without_tables_takes_those_of_the_next_one() -> None:
    """Where tau = 0 never comes in a design, its two tables are those of 1 and 2 slots at tau = 1."""
    gains = nested(np.array([[[[-2.0]]], [[[-3.0]]]]))
    loop = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.1, tau_max=1, d_max=0)
    running = SendAll(gains=gains, sojourns=(0, 2), selection="constant").start(loop)
    assert [running.rows(k, tau, (1.0,), (0.0,))[0][0] for k, tau in enumerate((0, 1))] == [-2.0, -2.0]  # type: ignore[union-attr,call-arg,arg-type]
    for sojourns in ((0, 1), (-1, 3)):
        with pytest.raises(FieldError, match=r"sojourns: .*, expected counts whose sum is the number of tables, 2"):
            SendAll(gains=gains, sojourns=sojourns)
