"""Random delays over a plant that jumps: exact beside a radius known in closed form, and between two sides where rates vary."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.processes.delay_chain import DelayChain
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem, VertexUncertainty
from design.semi_markov_loop.sampled import sampled_verdict
from design.verdict import Verdict
from tests.design.semi_markov_loop.test_sampled import exact_radius

T = 0.1
COIN = DelayChain(transition=[[0.5, 0.5], [0.5, 0.5]])
ONE = SemiMarkov(rates=((None,),))


def two(leave: float, back: float) -> SemiMarkov:
    return SemiMarkov(rates=((None, constant_rate(leave)), (constant_rate(back), None)))


def judged(a: list[float], k: list[float], process: SemiMarkov, **network: DelayChain | int) -> Verdict:
    modes = len(a)
    system = JumpSystem(a=np.array(a).reshape(modes, 1, 1), b=np.ones((modes, 1, 1)))
    return sampled_verdict(system, process, constant_gain(np.array(k).reshape(-1, 1, 1)), period_s=T, **network)


def exact(a: float, k: float) -> float:
    """One scalar mode, an even coin between a fresh sample and the one before: E of (x_k+1, x_k) (x) itself, two matrices."""
    f, g = math.exp(a * T), math.expm1(a * T) / a
    moves = [np.array([[f + g * k, 0.0], [1.0, 0.0]]), np.array([[f, g * k], [1.0, 0.0]])]
    return float(np.abs(np.linalg.eigvals(sum(np.kron(F, F) for F in moves) / 2)).max())


def test_one_mode_over_a_coin_has_the_radius_of_two_matrices() -> None:
    edge = next(k for k in np.arange(-20.0, -5.0, 0.05) if exact(1.0, k) < 1.0)  # the strongest gain that the network bears
    for chain in ("tau", "d"):
        for k in (edge + 0.02, edge - 0.07):
            found, radius = judged([1.0], [k], ONE, **{chain: COIN}), exact(1.0, k)
            assert found.state == ("certified" if radius < 1.0 else "refused")
            assert found.number == pytest.approx(radius, rel=2e-3)
    assert judged([1.0], [-0.9], ONE, tau=COIN).state == "refused"  # too weak to hold x' = x


def test_what_the_network_does_decides_beside_what_the_plant_does() -> None:
    late = DelayChain(transition=[[0.1, 0.9], [0.1, 0.9]])
    early = DelayChain(transition=[[0.9, 0.1], [0.9, 0.1]])
    states = [judged([1.0, 0.5], [-7.0, -7.0], two(1.0, 1.0), tau=tau, d=1).state for tau in (early, late)]
    assert states == ["certified", "refused"]
    leaving = [judged([1.0, -6.0], [0.0, 0.0], two(leave, 1.0), d=COIN).state for leave in (5.0, 2.1, 1.0)]
    assert leaving == ["certified", "refused", "refused"]  # 2.1 alone would do: what comes back from mode 2 is too much


def test_a_late_sample_is_acted_on_with_the_gain_of_its_own_mode() -> None:
    """A chain that is always at tau = 1 beside the exact radius of that constant delay."""
    always = DelayChain(transition=[[1.0, 0.0], [1.0, 0.0]], delays=[1, 0])
    for k in ([-3.0, -8.0], [-8.0, -3.0], [3.0, -8.0]):
        plant = JumpSystem(a=np.array([1.0, -1.0]).reshape(2, 1, 1), b=np.ones((2, 1, 1)))
        radius = exact_radius(plant, [[0.0, 4.0], [6.0, 0.0]], np.array(k).reshape(2, 1, 1), T, 1)
        found = judged([1.0, -1.0], k, two(4.0, 6.0), tau=always)
        assert found.state == ("certified" if radius < 1.0 else "refused")
        assert found.number == pytest.approx(radius, rel=2e-3)


def test_rates_that_vary_are_decided_by_the_side_that_bounds_them() -> None:
    ramp = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(1.0, 1.3))
    process = SemiMarkov(rates=((None, ramp), (constant_rate(1.0), None)))
    good, between, bad = (judged([a, -2.0], [0.0, 0.0], process, tau=COIN) for a in (-0.5, 0.4, 2.0))
    assert (good.state, between.state, bad.state) == ("certified", "undecided", "refused")
    assert "at least" in between.reason and "no bound below 1" in between.reason


def test_a_tail_that_is_known_by_bounds_enters_by_its_worse_side() -> None:
    """The sharp chain is certified; where only wide bounds of its probabilities are proved, nothing is."""
    matrix = np.array([[0.5, 0.5], [0.6, 0.4]])
    wide = (np.array([[0.5, 0.5], [0.3, 0.1]]), np.array([[0.5, 0.5], [0.9, 0.7]]))
    sharp, blunt = DelayChain(transition=matrix), DelayChain(transition=matrix, between=wide)
    assert [judged([0.5], [-1.5], ONE, tau=chain).state for chain in (sharp, blunt)] == ["certified", "undecided"]


def test_a_detected_mode_picks_the_gain_and_the_fault_moves_the_plant() -> None:
    failure, seen = two(1.0, 2.0), two(3.0, 4.0)
    system = JumpSystem(a=np.array([[[1.0]], [[-1.0]]]), b=np.ones((2, 1, 1)))
    process = FaultDetection(failure=failure, detection=(seen, seen), failure_restarts_detection_clock=False)
    pairs = list(itertools.product(range(2), range(2)))
    rows = [
        [None if i == j and k == l else constant_rate(
            ((1.0, 2.0)[i] if k == l and i != j else 0.0) + ((3.0, 4.0)[k] if i == j and k != l else 0.0)
        ) for j, l in pairs] for i, k in pairs
    ]  # fmt: skip
    whole = JumpSystem(a=system.a[[0, 0, 1, 1]], b=np.ones((4, 1, 1)))
    for k in ([-3.0, -2.0], [-3.0, 2.0], [-30.0, -2.0]):
        gain = np.array(k).reshape(2, 1, 1)
        one = sampled_verdict(system, process, constant_gain(gain), period_s=T, tau=COIN)
        product = SemiMarkov(rates=tuple(tuple(row) for row in rows))
        # every pair as a mode that is seen, with the gain of its detected mode
        other = sampled_verdict(whole, product, constant_gain(gain[[0, 1, 0, 1]]), period_s=T, tau=COIN)
        assert one.state == other.state and one.number == pytest.approx(other.number, rel=2e-3)


def test_what_is_too_large_or_unknown_is_undecided_with_its_size_or_reason() -> None:
    many = DelayChain(transition=np.full((6, 6), 1 / 6))
    assert "second moments, at most 2000" in judged([1.0, 1.0], [-3.0, -3.0], two(1.0, 1.0), tau=many).reason
    one, gain = np.ones((2, 1, 1)), constant_gain(np.zeros((2, 1, 1)))
    inside = DelayedJumpSystem(a=-one, ad=0.1 * one, b=one, e=one, c=one, delay_max_s=1.0, delay_slopes=np.zeros(2))
    vague = JumpSystem(a=-one, b=one, uncertainty=VertexUncertainty(da=0.1 * one[None], db=0.0 * one[None]))
    for system, why in ((inside, "a delay inside"), (vague, "uncertain matrices")):
        assert why in sampled_verdict(system, two(1.0, 1.0), gain, period_s=T, tau=COIN).reason
    by_age = ScheduledGain(gain=np.array([[[[-1.0]], [[-2.0]]]] * 2), starts_s=np.array([[0.0, 0.5]] * 2))
    plant = JumpSystem(a=-one, b=one)
    assert "sojourn time" in sampled_verdict(plant, two(1.0, 1.0), by_age, period_s=T, tau=COIN).reason
