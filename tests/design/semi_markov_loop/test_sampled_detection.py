"""Loops that are too large for their second moments: refused only where they grow while the mode stays, faster than it leaves."""

from __future__ import annotations

import math

import numpy as np

from design.controllers.scheduled_gain import constant_gain
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import JumpSystem, VertexUncertainty
from design.semi_markov_loop.sampled import sampled_verdict
from design.semi_markov_loop.sampled_detection import _grows, growth_while_it_stays
from design.semi_markov_loop.sojourn_renewal import SampledLoop

T, LATE = 0.05, 40
FAST = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(5.0, 60.0))


def integrator(modes: int = 1) -> JumpSystem:
    """x' = u, with u = -k x two seconds late: unstable from about k = pi / 4 on."""
    return JumpSystem(a=np.zeros((modes, 1, 1)), b=np.ones((modes, 1, 1)))


def test_a_form_proves_growth_only_where_every_direction_rises() -> None:
    mean = 2.0 * np.eye(2)
    assert _grows([np.diag([2.0, 3.0])], mean, 1.0, 2, 1.0)
    assert not _grows([np.diag([2.0, 3.0]), np.diag([0.1, 3.0])], mean, 1.0, 2, 1.0)


def loop(process: SemiMarkov, system: JumpSystem) -> SampledLoop:
    gain = constant_gain(np.zeros((system.modes, 1, 1)))
    return SampledLoop(system=system, process=process, gain=gain, period_s=T, tau=LATE, d=0)


def root(k: float) -> float:
    """Largest |z| with z^(D + 1) - z^D + k T = 0, squared: the growth of x^2 per period, without a matrix."""
    return float(np.abs(np.roots([1.0, -1.0, *[0.0] * (LATE - 1), k * T])).max() ** 2)


def growth(gains: list[float], exit_rate: float) -> float:
    one = loop(SemiMarkov(rates=((None,),)), integrator())
    return growth_while_it_stays(one, 0, [np.array([[-k]]) for k in gains], exit_rate)


def test_the_bound_is_below_the_exact_growth_and_close_to_it() -> None:
    for k in (0.85, 1.0, 2.0):
        assert 1.0 + 0.85 * (root(k) - 1.0) < growth([k], 0.0) < root(k)
    assert root(0.75) < 1.0
    assert growth([0.75], 0.0) == 0.0


def test_a_mode_that_is_left_faster_than_it_grows_proves_nothing() -> None:
    rate = math.log(root(1.0)) / T
    assert growth([1.0], 0.5 * rate) > 1.0
    assert growth([1.0], 1.01 * rate) == 0.0


def test_every_gain_that_may_act_must_let_it_grow() -> None:
    assert growth([1.0, 1.05], 0.0) > 1.0
    assert growth([1.8, 0.2], 0.0) == 0.0  # their mean grows, 0.2 alone does not


def test_a_fault_that_stays_refuses_whatever_is_detected() -> None:
    failure = SemiMarkov(rates=((None, constant_rate(0.05)), (constant_rate(1.0), None)))
    seen = SemiMarkov(rates=((None, FAST), (FAST, None)))
    process = FaultDetection(failure=failure, detection=(seen, seen), failure_restarts_detection_clock=False)

    def judged(gains: list[float]) -> tuple[str, float | None]:
        found = sampled_verdict(integrator(2), process, constant_gain(np.array(gains).reshape(2, 1, 1)), period_s=T, tau=LATE)
        return found.state, found.number

    state, number = judged([-1.0, -1.05])
    assert state == "refused" and number is not None and 1.0 < number < root(1.05)
    assert judged([-0.5, -0.5]) == ("undecided", None)


def test_an_uncertain_loop_too_large_is_not_refused_for_its_nominal_one() -> None:
    process = SemiMarkov(rates=((None, constant_rate(0.05)), (constant_rate(0.05), None)))
    vertices = VertexUncertainty(da=np.full((1, 2, 1, 1), -0.1), db=np.zeros((1, 2, 1, 1)))
    certain, plant = integrator(2), integrator(2)
    uncertain = JumpSystem(a=plant.a, b=plant.b, uncertainty=vertices)
    gain = constant_gain(np.full((2, 1, 1), -1.0))
    states = [sampled_verdict(system, process, gain, period_s=T, tau=LATE).state for system in (certain, uncertain)]
    assert states == ["refused", "undecided"]
