"""The verdict on a sampled jump loop is the same in all units of its states, its inputs and of time."""

from dataclasses import replace

import numpy as np
import pytest

from design.controllers.scheduled_gain import ScheduledGain
from design.processes.rates import clip_rate, constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem, NormBounded
from design.semi_markov_loop.sampled import sampled_verdict

A = np.array([[[0.3, 1.0], [-0.5, -0.2]], [[-0.4, 0.8], [0.0, -0.6]]])
B = np.array([[[0.0], [1.0]], [[0.0], [0.5]]])
AD = np.array([[[0.0, 0.0], [0.1, 0.0]], [[0.0, 0.0], [0.05, 0.05]]])
K = np.array([[[[-0.6, -1.4]], [[-0.5, -1.2]]], [[[-0.4, -1.0]], [[-0.4, -0.9]]]])
STARTS_S = np.array([[0.0, 0.25], [0.0, 0.4]])
UNITS = {"as it is": ((1.0, 1.0), 1.0, 1.0), "apart": ((1.0, 1e3), 1.0, 1.0), "small": ((1e6, 1e6), 1.0, 1.0),
         "input": ((1.0, 1.0), 1e-5, 1.0), "fine input": ((1.0, 1.0), 1e7, 1.0),
         "slow": ((1.0, 1.0), 1.0, 1e-4), "fast": ((1.0, 1.0), 1.0, 1e3)}  # fmt: skip


def judged(kind, states, inputs, speed):
    """x' = diag(states) x, u' = inputs u, and everything ``speed`` times as fast."""
    x = np.array(states)
    a, ad, b = (speed * M * x[:, None] / by for M, by in ((A, x), (AD, x), (B, inputs)))
    rate = clip_rate(0.2 * speed, 2.0 * speed, speed**2)
    process = SemiMarkov(rates=((None, rate), (rate, None)))
    gain = ScheduledGain(gain=inputs * K / x, starts_s=STARTS_S / speed)
    system = JumpSystem(a=a, b=b)
    if kind == "uncertain":
        low = np.array([[[0.2, 0.1]], [[0.1, 0.2]]]) * speed / x
        bound = NormBounded(e=np.array([[[0.0], [0.3]]] * 2) * x[:, None], fa=low, fb=np.zeros((2, 1, 1)))
        system = replace(system, uncertainty=bound)
    if kind == "delay inside":
        slopes = np.full(2, 0.1)
        system = DelayedJumpSystem(a=a, ad=ad, b=b, e=b, c=a, delay_max_s=0.2 / speed, delay_slopes=slopes)
    if kind == "detected":
        seen = SemiMarkov(rates=((None, constant_rate(3.0 * speed)), (constant_rate(4.0 * speed), None)))
        process = FaultDetection(failure=process, detection=(seen, seen), failure_restarts_detection_clock=False)
    return sampled_verdict(system, process, gain, period_s=0.1 / speed, d=1)


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("kind", ["one process", "uncertain", "delay inside", "detected"])
def test_no_verdict_depends_on_units(kind, units):
    found = judged(kind, *UNITS[units])
    assert found.state == "certified", found.reason
    if kind == "one process":
        assert found.number == pytest.approx(judged(kind, *UNITS["as it is"]).number, rel=1e-9)
