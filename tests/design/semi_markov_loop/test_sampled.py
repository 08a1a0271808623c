"""The sampled jump loop beside exact moments (constant rates) and beside literal event simulation (rates with memory)."""

import itertools
import math
from contextlib import nullcontext

import numpy as np
import pytest
from scipy.linalg import expm

from design.as_printed import (
    chapter2_gain,
    chapter2_process,
    chapter2_system,
    chapter4_process,
    chapter4_seen_gain,
    chapter4_system,
)
from design.controllers import LoopModel
from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.errors import FieldError
from design.processes.delay_chain import DelayChain
from design.processes.rates import PiecewiseLinearRate, WeibullRate, constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.requests.scheduled import scheduled_of
from design.semi_markov_loop import JumpSystem, NormBounded, VertexUncertainty
from design.semi_markov_loop import period_moments as moments_module
from design.semi_markov_loop.period_moments import STIFF, Box, TooLarge, isometry, period_moments, smat
from design.semi_markov_loop.sampled import sampled_verdict
from design.semi_markov_loop.second_moments import second_moment_radius
from design.semi_markov_loop.sojourn_renewal import SampledLoop, renewal_matrix, renewal_radius


def _constant_process(rates):
    rows = [tuple(None if i == j else constant_rate(v) for j, v in enumerate(row)) for i, row in enumerate(rates)]
    return SemiMarkov(rates=tuple(rows))


def exact_radius(system, rates, gains, T, delay):
    """Spectral radius per period of the moments of (x, v_-1, ..., v_-D), constant rates: nothing but a matrix exponential."""
    modes, n, m = system.modes, system.states, system.inputs
    size = n + m * (delay + 1)
    flow = np.zeros((modes, size * size, modes, size * size))
    for i in range(modes):
        generator = np.zeros((size, size))
        generator[:n, :n], generator[:n, size - m :] = system.a[i], system.b[i]
        flow[i, :, i, :] = np.kron(generator, np.eye(size)) + np.kron(np.eye(size), generator)
        for j in range(modes):
            if i != j:
                flow[j, :, i, :] += rates[i][j] * np.eye(size * size)
                flow[i, :, i, :] -= rates[i][j] * np.eye(size * size)
    count = modes * size * size
    one = expm(flow.reshape(count, count) * T)
    sample, keep = np.zeros((modes, size, size - m)), np.eye(size - m, size)
    sample[:, :n, :n], sample[:, n + m :, n:] = np.eye(n), np.eye(size - m - n)
    sample[:, n : n + m, :n] = gains
    left = np.kron(np.eye(modes), np.kron(keep, keep))
    right = np.zeros((modes, size * size, modes, (size - m) ** 2))
    for i in range(modes):
        right[i, :, i, :] = np.kron(sample[i], sample[i])
    return np.abs(np.linalg.eigvals(left @ one @ right.reshape(count, -1))).max()


def _random_loop(rng, modes):
    n = int(rng.integers(1, 4))
    a, b = rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, 1))
    gain = rng.normal(size=(modes, 1, n)) - 0.7 * np.swapaxes(b, 1, 2)
    return JumpSystem(a=a - 0.3 * np.eye(n), b=b), gain


def test_constant_rates_are_judged_as_the_exact_moments_judge_them():
    rng, states = np.random.default_rng(11), []
    for _ in range(40):
        modes = int(rng.integers(2, 4))
        system, gain = _random_loop(rng, modes)
        rates, T = rng.exponential(2.0, (modes, modes)), float(rng.choice([0.02, 0.1, 0.4]))
        tau, d = (int(v) for v in rng.integers(0, 3, 2))
        exact = exact_radius(system, rates, gain, T, tau + d)
        verdict = sampled_verdict(system, _constant_process(rates), constant_gain(gain), period_s=T, tau=tau, d=d)
        assert verdict.state == ("certified" if exact < 1 else "refused")
        states.append(verdict.state)
    assert min(states.count("certified"), states.count("refused")) >= 10


RAMP = PiecewiseLinearRate(times_s=(0.0, 2.0, 3.0), values=(0.8, 2.0, 1.2))
FALL = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(4.0, 3.0))
SCALAR = JumpSystem(a=np.array([[[0.6]], [[-0.4]]]), b=np.array([[[1.0]], [[1.0]]]))
SECTIONS = ScheduledGain(
    gain=np.array([[[[-0.5]], [[-3.0]], [[-1.5]]], [[[0.2]], [[-2.0]], [[0.4]]]]),
    starts_s=np.array([[0.0, 0.5, 0.9], [0.0, 0.3, 1.3]]),
)


def _simulate(loop, controller, runs, rng):
    """x^2 at the first sample in another mode, from x = 1 at a first sample in mode 0, scalar plant, controller that runs."""
    T, a, b = loop.period_s, loop.system.a[:, 0, 0], loop.system.b[:, 0, 0]
    x, memory, ends = np.ones(runs), [np.zeros(runs)] * loop.delay, []
    mode, entered = np.zeros(runs, dtype=int), np.zeros(runs)
    h, target = loop.process.next_jump(mode, rng)
    for k in range(10_000):
        row = controller.rows(k + loop.tau, loop.tau, (1.0, 1.0), (0.0, 0.0))[0][0]
        memory = [row * x, *memory]
        u, memory = memory[-1], memory[:-1]
        now = np.full(x.size, k * T)
        while (now < (k + 1) * T).any():
            at = np.minimum(entered + h, (k + 1) * T)
            grown = np.exp(a[mode] * (at - now))
            x, now = grown * x + (grown - 1.0) / a[mode] * b[mode] * u, at
            jump = entered + h < (k + 1) * T
            entered[jump], mode[jump] = at[jump], target[jump]
            fresh, onward = loop.process.next_jump(mode, rng)
            h, target = np.where(jump, fresh, h), np.where(jump, onward, target)
        seen = mode != 0
        ends.append(x[seen] ** 2)
        x, mode, entered, h, target = (v[~seen] for v in (x, mode, entered, h, target))
        memory = [v[~seen] for v in memory]
        if not x.size:
            return np.concatenate(ends)
    raise AssertionError("a sojourn did not end")


@pytest.mark.parametrize(("T", "tau", "d"), [(0.05, 0, 0), (0.2, 0, 0), (0.1, 1, 1)])
def test_moments_of_a_seen_sojourn_lie_between_both_sides(T, tau, d):
    # 40000 runs, 4 sigma on each side: level below 1e-4; a bound wrong by more than 3 % and half the gap between the sides fails
    process = SemiMarkov(rates=((None, RAMP), (FALL, None)))
    loop = SampledLoop(system=SCALAR, process=process, gain=SECTIONS, period_s=T, tau=tau, d=d)
    start = isometry(loop.size).T @ np.outer(np.eye(loop.size)[0], np.eye(loop.size)[0]).ravel()
    low, high = (smat(renewal_matrix(loop, [0, 1], upper=upper)[1, :, 0, :] @ start)[0, 0] for upper in (False, True))
    model = LoopModel(A=np.eye(1), B=np.ones((1, 1)), C=np.eye(2, 1), period_s=T, tau_max=tau, d_max=d)
    ends = _simulate(loop, scheduled_of(SECTIONS).start(model), 40_000, np.random.default_rng(5))
    error = np.std(ends) / math.sqrt(ends.size)
    assert error < 0.008 * np.mean(ends)
    assert low - 4 * error < np.mean(ends) < high + 4 * error
    assert high < (1.0 + 4.0 * T) * low


def test_sides_close_on_the_loop_that_acts_at_every_instant():
    system, process, gain = chapter2_system("none"), chapter2_process(), chapter2_gain()
    exact = second_moment_radius(system, gain, process)
    gaps = []
    for T in (0.02, 0.005):
        loop = SampledLoop(system=system, process=process, gain=gain, period_s=T, tau=0, d=0)
        low, high = (renewal_radius(loop, [0, 1], upper=upper) for upper in (False, True))
        assert low < high < exact + 5 * T
        assert low > exact - 5 * T
        gaps.append(high - low)
    assert gaps[1] < 0.3 * gaps[0]


def test_a_loop_between_the_sides_of_whole_periods_is_decided_by_parts_of_them_and_one_at_the_edge_is_not():
    ramp = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(0.2, 4.0))
    process = SemiMarkov(rates=((None, ramp), (constant_rate(2.0), None)))
    system = JumpSystem(a=np.array([[[1.0]], [[-1.0]]]), b=np.array([[[1.0]], [[0.0]]]))
    gain = constant_gain(np.array([[[-0.2]], [[0.0]]]))
    loop = SampledLoop(system=system, process=process, gain=gain, period_s=0.1, tau=0, d=0)
    assert renewal_radius(loop, [0, 1], upper=False) < 1.0 < renewal_radius(loop, [0, 1], upper=True)
    found = sampled_verdict(system, process, gain, period_s=0.1)
    assert found.state == "refused" and "parts of it" in found.reason
    edge = JumpSystem(a=np.array([[[0.25]], [[-1.0]]]), b=np.zeros((2, 1, 1)))  # E x^2 stays: [[-0.5, 2], [1, -4]] has the root 0
    assert sampled_verdict(edge, _constant_process([[0.0, 1.0], [2.0, 0.0]]), gain, period_s=0.1).state == "undecided"


def test_a_delay_that_destabilises_is_refused():
    system, process, gain = chapter2_system("none"), chapter2_process(), chapter2_gain()
    assert sampled_verdict(system, process, gain, period_s=0.005, tau=1, d=1).certified
    assert sampled_verdict(system, process, gain, period_s=0.1, tau=1, d=1).state == "refused"


def test_uncertainty_that_varies_freely_is_certified_within_its_bounds_only():
    system, process, gain = chapter2_system("printed"), chapter2_process(), chapter2_gain()
    assert sampled_verdict(system, process, gain, period_s=0.005).certified
    vertices = chapter2_system("vertices").scaled(0.3)
    assert sampled_verdict(vertices, process, gain, period_s=0.005).certified
    # dx/dt = (-1 + size delta) x, |delta| <= 1: with delta = 1 for ever it grows where size > 1, and nominally never
    one, still = np.ones((2, 1, 1)), constant_gain(np.zeros((2, 1, 1)))
    for size, state in ((0.5, "certified"), (4.0, "undecided")):
        norm = NormBounded(e=one, fa=size * one, fb=0.0 * one)
        varying = JumpSystem(a=-one, b=0.0 * one, uncertainty=norm)
        assert sampled_verdict(varying, _constant_process([[0.0, 1.0], [1.0, 0.0]]), still, period_s=0.05).state == state


@pytest.mark.parametrize(("size", "state"), [(0.2, "certified"), (4.0, "refused")])
def test_a_vertex_that_is_not_stable_for_ever_refutes(size, state):
    """The nominal loop is stable; at a constant vertex its mean square grows as exp(2 (size - 1) t) at least."""
    change = np.full((1, 2, 1, 1), size)
    uncertainty = VertexUncertainty(da=np.concatenate([-change, change]), db=np.zeros((2, 2, 1, 1)))
    system = JumpSystem(a=np.array([[[-1.0]], [[-2.0]]]), b=np.zeros((2, 1, 1)), uncertainty=uncertainty)
    process = _constant_process([[0.0, 1.0], [1.0, 0.0]])
    found = sampled_verdict(system, process, constant_gain(np.zeros((2, 1, 1))), period_s=0.05)
    assert found.state == state
    assert ("at vertex 2" in found.reason) == (state == "refused")


def test_what_the_theory_does_not_know_is_undecided():
    system, process, gain = chapter2_system("none"), chapter2_process(), chapter2_gain()
    random = DelayChain(transition=[[0.5, 0.5], [0.5, 0.5]])
    assert sampled_verdict(system, process, gain, period_s=0.005, tau=random).state == "undecided"
    constant = DelayChain(transition=[[1.0]], delays=[1])
    assert sampled_verdict(system, process, gain, period_s=0.02, d=constant).certified
    endless = SemiMarkov(rates=((None, WeibullRate(scale_s=1.0, shape=0.5)), (constant_rate(1.0), None)))
    assert sampled_verdict(system, endless, gain, period_s=0.005).state == "undecided"
    assert sampled_verdict(system, process, gain, period_s=0.005, tau=200).state == "undecided"


def test_a_period_that_is_long_for_its_matrices_is_not_integrated():
    """2 |A| T is bounded: beyond it so many nodes would be wrong, or as many as the caller asks for."""
    boxes = [Box(low=np.zeros(1), high=np.zeros(1))]
    for T, most in ((1.9, True), (2.1, False)):
        system = JumpSystem(a=np.array([[[-STIFF / 4.0]]]), b=np.zeros((1, 1, 1)))
        with nullcontext() if most else pytest.raises(TooLarge, match=r"2 \|A\| T = 16\.8, at most 16"):
            period_moments(system, boxes, T, 0, upper=True)


def test_an_input_in_any_unit_leaves_the_period_as_long_as_it_is():
    boxes = [Box(low=np.zeros(1), high=np.zeros(1))]
    systems = [JumpSystem(a=np.array([[[-1.0]]]), b=np.array([[[b]]])) for b in (2.0, 2.0**12)]
    fine, coarse = (period_moments(system, boxes, 1.0, 0, upper=True).still for system in systems)
    np.testing.assert_allclose(fine * np.array([1.0, 2.0**11, 2.0**22]), coarse, rtol=1e-12)


@pytest.mark.parametrize("length", [0.5, 3.9, 7.9])
def test_the_nodes_that_a_plant_needs_are_enough_for_its_inputs_too(length, monkeypatch):
    """Up to 2 |A| T = 16 more nodes change rounding only; how large B is in other units changes every node's share alike."""
    rng = np.random.default_rng(round(10 * length))
    a, b = rng.normal(size=(2, 3, 3)), rng.normal(size=(2, 3, 1))
    T = length / np.linalg.norm(a, 2, axis=(1, 2)).max()
    boxes = [Box(low=rates / T, high=rates / T) for rates in (np.array([0.0, 2.0]), np.array([1.0, 0.0]))]

    def integral():
        found = period_moments(JumpSystem(a=a, b=b), boxes, T, 0, upper=True)
        return np.einsum("ijlgpq,g->ijlpq", found.jumped, found.weights_s)

    few = integral()
    points, weights = np.polynomial.legendre.leggauss(60)
    monkeypatch.setattr(moments_module, "_first_jump", lambda stiffness, T: (0.5 * T * (points + 1.0), 0.5 * T * weights))
    np.testing.assert_allclose(few, integral(), rtol=1e-10, atol=1e-12 * np.abs(few).max())


# -- Chapter 4 ------------------------------------------------------------------------------------------------------------------

FAULTS = chapter4_process(failure_restarts_detection_clock=False)


def test_printed_gains_of_chapter_4_at_their_period():
    partitioned = sampled_verdict(chapter4_system(), FAULTS, chapter4_seen_gain(partitioned=True), period_s=1e-3)
    assert partitioned.certified
    single = sampled_verdict(chapter4_system(), FAULTS, chapter4_seen_gain(partitioned=False), period_s=1e-3)
    assert single.state == "refused"


def test_another_effectiveness_is_not_certified():
    system, gain = chapter4_system(), chapter4_seen_gain(partitioned=True)
    b = system.b.copy()
    b[1, 1, 0] = -60.0 * b[0, 1, 0]
    other = JumpSystem(a=system.a, b=b)
    assert sampled_verdict(other, FAULTS, gain, period_s=1e-3).state != "certified"
    assert sampled_verdict(system, FAULTS, gain, period_s=1e-3, tau=30, d=30).state != "certified"


def test_failure_and_detection_at_constant_rates_are_never_judged_against_the_exact_moments():
    rng, states = np.random.default_rng(3), []
    for _ in range(24):
        system, gain = _random_loop(rng, 2)
        failure, r1, r2 = rng.exponential(2.0, (3, 2, 2))
        T, tau = float(rng.choice([0.02, 0.1])), int(rng.integers(0, 2))
        process = FaultDetection(
            failure=_constant_process(failure), detection=(_constant_process(r1), _constant_process(r2)),
            failure_restarts_detection_clock=False,
        )  # fmt: skip
        pairs = list(itertools.product(range(2), range(2)))
        rates = [
            [failure[i][j] * (k == l) + (r1, r2)[i][k][l] * (i == j) if (i, k) != (j, l) else 0.0 for j, l in pairs]
            for i, k in pairs
        ]
        big = JumpSystem(a=system.a[[0, 0, 1, 1]], b=system.b[[0, 0, 1, 1]])
        exact = exact_radius(big, rates, gain[[0, 1, 0, 1]], T, tau)
        verdict = sampled_verdict(system, process, constant_gain(gain), period_s=T, tau=tau)
        assert verdict.state in ("undecided", "certified" if exact < 1 else "refused")
        states.append(verdict.state)
    assert min(states.count("certified"), states.count("refused")) >= 5
    assert states.count("undecided") <= 3


def test_one_failure_mode_is_judged_as_one_process():
    # a gain that destabilises on [0.5, 0.9) of r's clock only: both proofs see the same loop
    process = SemiMarkov(rates=((None, RAMP), (FALL, None)))
    both = FaultDetection(failure=_constant_process([[0.0]]), detection=(process,), failure_restarts_detection_clock=False)
    one = JumpSystem(a=SCALAR.a[:1], b=SCALAR.b[:1])
    for factor, states in ((1.0, ("certified",)), (-1.0, ("refused", "undecided"))):
        gain = ScheduledGain(gain=np.abs(SECTIONS.gain) * -factor - 0.8, starts_s=SECTIONS.starts_s)
        twice = JumpSystem(a=SCALAR.a[[0, 0]], b=SCALAR.b[[0, 0]])
        single = sampled_verdict(twice, process, gain, period_s=0.05)
        assert single.state == ("certified" if factor > 0 else "refused")
        assert sampled_verdict(one, both, gain, period_s=0.05).state in states


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"period_s": 0.0}, "period_s"), ({"period_s": math.inf}, "period_s"), ({"period_s": math.nan}, "period_s"),
        ({"tau": -1}, "tau"), ({"d": -1}, "d"),
        ({"gain": constant_gain(np.zeros((2, 1, 2)))}, "gain"), ({"gain": constant_gain(np.zeros((1, 1, 1)))}, "gain"),
        ({"process": _constant_process([[0.0, 1.0, 1.0], [2.0, 0.0, 1.0], [1.0, 1.0, 0.0]])}, "process"),
    ],
)  # fmt: skip
def test_parts_that_do_not_fit_each_other_are_refused(changes, field):
    parts = {
        "system": JumpSystem(a=np.full((2, 1, 1), -1.0), b=np.ones((2, 1, 1))),
        "process": _constant_process([[0.0, 1.0], [2.0, 0.0]]),
        "gain": constant_gain(np.zeros((2, 1, 1))),
        "period_s": 0.1,
    }
    assert sampled_verdict(**parts).certified
    with pytest.raises(FieldError) as refused:
        sampled_verdict(**parts | changes)
    assert refused.value.field == field
