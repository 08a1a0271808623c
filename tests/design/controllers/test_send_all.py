"""Gain tables in the loop, and the integral of the error."""

from __future__ import annotations

import numpy as np

from design.controllers import LoopModel, SendAll, nested

INTEGRATOR = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.1, tau_max=0, d_max=0)


def test_the_integral_holds_the_errors_of_earlier_slots_only() -> None:
    """u(k) = -2 e(k) + 10 sum over j < k of e(j): the error of slot k enters the integral in slot k + 1."""
    gains = nested(np.array([[[[-2.0, 10.0]]]]))
    running = SendAll(gains=gains, integral=True, selection="constant").start(INTEGRATOR)
    answers = [running.rows(k, 0, (e,), (0.0,))[0][0] for k, e in enumerate((1.0, 0.5, 0.25))]
    assert answers == [-2.0, -1.0 + 10.0, -0.5 + 15.0]
