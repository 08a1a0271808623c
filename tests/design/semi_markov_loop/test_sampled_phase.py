"""The Lyapunov function of an uncertain sampled loop: what it decides, and where its inequalities hold."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from design.as_printed import chapter3_gain, chapter3_process, chapter3_system
from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.processes.rates import PiecewiseLinearRate, WeibullRate, constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem, NormBounded, VertexUncertainty
from design.semi_markov_loop.sampled import MARGIN, sampled_verdict
from design.semi_markov_loop.sampled_phase import UncertainProgram, uncertain_decrease
from design.semi_markov_loop.sojourn_renewal import SampledLoop
from design.verdict import Verdict

AGEING = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(0.2, 3.0))
PROCESS = SemiMarkov(rates=((None, AGEING), (constant_rate(2.0), None)))
T = 0.05


def plant(size: float, *, norm: bool = False) -> JumpSystem:
    """Two scalar modes, the second unstable; what is uncertain in both is up to a size."""
    a, b = np.array([[[0.5]], [[1.0]]]), np.ones((2, 1, 1))
    if norm:
        one = np.ones((2, 1, 1))
        return JumpSystem(a=a, b=b, uncertainty=NormBounded(e=one, fa=size * one, fb=0.0 * one))
    both = np.full((1, 2, 1, 1), size)
    return JumpSystem(a=a, b=b, uncertainty=VertexUncertainty(da=np.concatenate([-both, both]), db=np.zeros((2, 2, 1, 1))))


def loop(system: JumpSystem, gain: ScheduledGain, d: int = 0) -> SampledLoop:
    return SampledLoop(system=system, process=PROCESS, gain=gain, period_s=T, tau=0, d=d)


SECTIONS = ScheduledGain(
    gain=np.array([[[[-1.5]], [[-2.0]], [[-2.5]]], [[[-3.0]], [[-2.0]], [[-2.0]]]]),
    starts_s=np.array([[0.0, 0.08, 0.6], [0.0, 0.3, 0.4]]),
)


@pytest.mark.parametrize("norm", [False, True])
def test_what_the_bounds_of_the_moments_leave_open_is_decided(norm: bool) -> None:
    gain = constant_gain(np.array([[[-1.5]], [[-2.0]]]))
    found = sampled_verdict(plant(0.95, norm=norm), PROCESS, gain, period_s=T)
    assert found.certified and "Lyapunov function over age and phase" in found.method


@pytest.mark.parametrize("norm", [False, True])
def test_it_is_found_as_long_as_every_constant_plant_is_stable(norm: bool) -> None:
    """Held gains -1.5 and -2: a mode that stays for ever is stable while a + size < 1.5 and 2, nearly."""
    gain = constant_gain(np.array([[[-1.5]], [[-2.0]]]))
    assert uncertain_decrease(loop(plant(0.6, norm=norm), gain)).margin > MARGIN
    for shape in ((4, 1), (4, 4)):
        assert not UncertainProgram(loop(plant(3.0, norm=norm), gain), *shape).built().solve().margin > MARGIN


@pytest.mark.parametrize("schedule", ["hold", "linear"])
@pytest.mark.parametrize("d", [0, 1])
def test_it_falls_at_every_age_phase_rate_and_uncertainty_between_those_that_were_asked(schedule: str, d: int) -> None:
    gain = ScheduledGain(gain=SECTIONS.gain, starts_s=SECTIONS.starts_s, schedule=schedule)
    of = loop(plant(0.4), gain, d)
    program = UncertainProgram(of, 4, 2)
    found = program.built().solve()
    assert found.margin > MARGIN and found.slack >= 0.0
    P, rng, size = found.matrices, np.random.default_rng(5), of.size + 1

    def at(name: str, phase: str, s: float) -> np.ndarray:
        """U + W(s), or X at a node + Y(s)."""
        values = [np.zeros((size, size)), *(T * P[f"{phase}{k}"] for k in (1, 2))]
        k = min(int(2 * s / T), 1)
        share = 2 * s / T - k
        return P[name] + (1 - share) * values[k] + share * values[k + 1]

    for _ in range(300):
        i, b = int(rng.integers(2)), int(rng.integers(3))
        s, h, step = rng.uniform(0.001, T - 0.001), rng.uniform(0.0, 1.5), 1e-7
        starts, nodes = gain.starts_s[i], program.nodes[i]
        if b < 2 and h > starts[b + 1] + 2 * T:
            continue

        def value(h: float, s: float, i: int = i, b: int = b, nodes: np.ndarray = nodes) -> np.ndarray:
            c = min(int(np.searchsorted(nodes, h, side="right")) - 1, len(nodes) - 2) if h < nodes[-1] else len(nodes) - 1
            if c == len(nodes) - 1:
                return at(f"X[{i},{b},{c}]", f"Y[{i},{b}]", s)
            share = (h - nodes[c]) / (nodes[c + 1] - nodes[c])
            first, last = (at(f"X[{i},{b},{k}]", f"Y[{i},{b}]", s) for k in (c, c + 1))
            return (1 - share) * first + share * last

        flow = np.zeros((size, size))
        flow[0, 0], flow[0, -1] = of.system.a[i, 0, 0] + rng.uniform(-0.4, 0.4), 1.0
        here, rate = value(h, s), float(PROCESS.rate(i, h)[1 - i])
        change = (value(h + step, s + step) - here) / step + here @ flow + flow.T @ here
        change += rate * (at(f"U[{1 - i},{i}]", f"W[{1 - i},{i}]", s) - here)
        assert np.linalg.eigvalsh(0.5 * (change + change.T))[-1] < 0.0
        count = int(rng.integers(0, 40))
        section = int(np.searchsorted(starts, count * T, side="right")) - 1
        after = int(np.searchsorted(starts, (count + 1) * T, side="right")) - 1
        if h > (count + 1) * T:
            continue  # no mode is older than the samples that have found it
        K = of.sampled_at(gain.at(i, (count + 1) * T)) @ np.eye(of.size, size)
        landed = K.T @ value(h, 0.0, i, after) @ K
        assert np.linalg.eigvalsh(value(h, T - 1e-12, i, section) - landed)[0] > -1e-6


def test_a_gain_that_another_section_would_need_is_seen() -> None:
    """Only the third section destabilises; a mode that has been left and entered again unseen may come back into it too."""
    bad = ScheduledGain(gain=SECTIONS.gain + np.array([0.0, 0.0, 5.0])[None, :, None, None], starts_s=SECTIONS.starts_s)
    for shape in ((4, 1), (4, 4)):
        holds = [UncertainProgram(loop(plant(0.1), gain), *shape).built().solve().margin > MARGIN for gain in (SECTIONS, bad)]
        assert holds == [True, False]
    assert sampled_verdict(plant(0.1), PROCESS, bad, period_s=T).state == "refused"


def test_rates_within_a_cell_are_as_large_as_they_get() -> None:
    """A visit to mode 2 multiplies second moments by 10. Left at 0.2/s, mode 1 makes 0.1 of them; its rate reaches 6/s."""
    peak = PiecewiseLinearRate(times_s=(0.0, 0.5, 1.0), values=(0.2, 6.0, 0.2))
    states = []
    for rate in (constant_rate(0.2), peak):
        process = SemiMarkov(rates=((None, rate), (constant_rate(2.0), None)))
        gain = constant_gain(np.array([[[-1.5]], [[-0.1]]]))
        of = SampledLoop(system=plant(1e-3), process=process, gain=gain, period_s=0.01, tau=0, d=0)
        states.append(UncertainProgram(of, 1, 1).built().solve().margin > MARGIN)
    assert states == [True, False]


ONE = SemiMarkov(rates=((None,),))
RAMP = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(0.5, 3.0))


LONG = 1e4
"""A delay (s) so long that its bound says nothing."""


def scalar(a: list[float], ad: list[float], slopes: list[float], b: float = 1.0, longest: float = 2.0) -> DelayedJumpSystem:
    modes = len(a)
    column = [np.array(values).reshape(modes, 1, 1) for values in (a, ad)]
    one = np.ones((modes, 1, 1))
    return DelayedJumpSystem(
        a=column[0], ad=column[1], b=b * one, e=one, c=one, delay_max_s=longest, delay_slopes=np.array(slopes)
    )  # fmt: skip


def judged(system: DelayedJumpSystem, process: SemiMarkov, gain: list[float], **more: Any) -> Verdict:
    table = constant_gain(np.array(gain).reshape(-1, 1, 1))
    return sampled_verdict(system, process, table, period_s=0.05, **more)


@pytest.mark.parametrize("slope", [0.0, 0.6])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_mode_is_certified_up_to_the_limit_of_a_delay_that_grows(slope: float, sign: float) -> None:
    """x' = -x + g x(t - tau), tau' <= h, tau as long as it likes: the condition is |g| < sqrt(1 - h), here from both sides."""
    limit = math.sqrt(1.0 - slope)
    states = [judged(scalar([-1.0], [sign * share * limit], [slope], longest=LONG), ONE, [0.0]).state for share in (0.97, 1.03)]
    assert states == ["certified", "refused" if sign * limit == 1.0 else "undecided"]  # without a delay 1.03 x grows


@pytest.mark.parametrize("slope", [0.0, 0.9])
@pytest.mark.parametrize("g", [1.0, 20.0])
def test_a_delay_that_is_short_is_certified_however_it_changes(slope: float, g: float) -> None:
    """x' = -g x(t - tau) rests on its delayed state alone: certified up to g tau = 1; a constant g tau = 1.6 > pi/2 grows."""
    states = [judged(scalar([0.0], [-g], [slope], longest=share / g), ONE, [0.0]).state for share in (0.95, 1.6)]
    assert states == ["certified", "undecided"]


def test_a_plant_that_grows_without_its_delay_is_refused() -> None:
    """x' = a x + g x(t - tau) is unstable at tau = 0 for g > -a, whatever other delays do; feedback holds it."""
    unstable = ((0.2, -0.1, 0.0, "refused"), (-0.2, 0.3, 0.0, "refused"))
    for a, g, k, state in (*unstable, (0.2, -0.1, -0.5, "certified"), (0.2, -0.3, 0.0, "certified")):
        found = judged(scalar([a], [g], [0.3], longest=0.5), ONE, [k])
        assert found.state == state, (a, g, k, found.reason)
    assert "delay of 0" in judged(scalar([0.2], [-0.1], [0.3]), ONE, [0.0]).reason
    assert judged(scalar([0.2], [-0.3], [0.3], longest=0.0), ONE, [0.0]).certified


def test_a_plant_that_is_never_without_its_delay_is_not_refused_for_it() -> None:
    unstable, stable = (scalar([a], [g], [0.3], longest=0.5) for a, g in ((0.2, -0.1), (0.2, -0.3)))
    for least, state in ((0.0, "refused"), (0.1, "undecided")):
        found = judged(unstable, ONE, [0.0], least_delay_s=least)
        assert found.state == state
    assert "the plant has 0.1 s at least" in found.reason
    assert judged(stable, ONE, [0.0], least_delay_s=0.1).certified


def test_modes_that_jump_may_read_one_instant_once_in_every_mode() -> None:
    """Two equal modes, delays that differ: |g| < (1 / (1 - h_1) + 1 / (1 - h_2))^(-1/2), below what either alone allows."""
    process = SemiMarkov(rates=((None, RAMP), (constant_rate(2.0), None)))
    limit = (1.0 / (1.0 - 0.2) + 1.0 / (1.0 - 0.6)) ** -0.5
    loops = [scalar([-1.0, -1.0], [share * limit] * 2, [0.2, 0.6], longest=LONG) for share in (0.97, 1.03)]
    states = [judged(loop, process, [0.0, 0.0]).state for loop in loops]
    assert states == ["certified", "undecided"]


def test_feedback_that_is_sampled_and_late_decides() -> None:
    """x' = 0.5 x + 0.2 x(t - tau) + u, u = -k x(t_k - D T): k = 2 holds it, k = 0 does not, k = 2 late by 16 periods does not."""
    system = scalar([0.5], [0.2], [0.3])
    assert judged(system, ONE, [-2.0]).certified
    assert judged(system, ONE, [-2.0], tau=1, d=1).certified
    assert judged(system, ONE, [0.0]).state == "refused"
    assert judged(system, ONE, [-2.0], tau=8, d=8).state == "refused"
    assert judged(system, ONE, [-45.0]).state == "refused"  # 1 - 45 T < -1: too much for the period


def test_rates_decide_which_mode_weighs() -> None:
    """Mode 1 grows, mode 2 falls: certified where mode 1 is left quickly, not where it is left slowly."""

    def state(leave: float) -> str:
        process = SemiMarkov(rates=((None, constant_rate(leave)), (constant_rate(1.0), None)))
        return judged(scalar([0.5, -2.0], [0.1, 0.1], [0.3, 0.3]), process, [0.0, 0.0]).state

    assert [state(8.0), state(1.5)] == ["certified", "refused"]


def test_every_section_of_the_gain_counts() -> None:
    process = SemiMarkov(rates=((None, RAMP), (RAMP, None)))
    system = scalar([0.5, 0.5], [0.1, 0.1], [0.3, 0.3])
    for late, state in ((-3.0, "certified"), (1.0, "refused")):
        gain = np.array([[[[-2.0]], [[-3.0]]], [[[-2.0]], [[late]]]])
        table = ScheduledGain(gain=gain, starts_s=np.array([[0.0, 0.5], [0.0, 0.5]]))
        assert sampled_verdict(system, process, table, period_s=0.05).state == state


def test_a_section_is_left_at_the_rates_that_are_there_while_it_lasts() -> None:
    """A mode grows until its next section acts, two periods after its start; it is left 8 times a second, from 1.2 s on never."""
    step = PiecewiseLinearRate(times_s=(0.0, 1.2, 1.2), values=(8.0, 8.0, 0.0))
    process, system = SemiMarkov(rates=((None, step), (constant_rate(1.0), None))), scalar([0.5, -2.0], [0.1, 0.1], [0.3, 0.3])
    gain = np.array([[[[0.0]], [[-3.0]], [[-3.0]]], [[[0.0]]] * 3])
    for start_s, state in ((1.09, "certified"), (1.11, "undecided")):
        table = ScheduledGain(gain=gain, starts_s=np.array([[0.0, start_s, 5.0]] * 2))
        assert sampled_verdict(system, process, table, period_s=0.05).state == state


def test_the_helicopter_is_certified_at_its_period_by_a_margin_that_is_stated() -> None:
    system, process, gain = chapter3_system(), chapter3_process(), chapter3_gain()
    found = sampled_verdict(system, process, gain, period_s=0.01)
    assert found.certified and found.number is not None and found.number < -1e-3
    assert found.limit == 0.0 and any("slope" in assumption for assumption in found.assumptions)


def test_what_the_proof_does_not_know_is_undecided_with_its_size_or_reason() -> None:
    late = judged(scalar([-0.5], [0.2], [0.3]), ONE, [0.0], tau=30, d=30)
    assert late.state == "undecided" and "unknowns" in late.reason
    endless = SemiMarkov(rates=((None, WeibullRate(scale_s=1.0, shape=0.5)), (constant_rate(1.0), None)))
    two = scalar([-1.0, -1.0], [0.1, 0.1], [0.0, 0.0])
    assert "finite bound" in judged(two, endless, [0.0, 0.0]).reason
    linear = ScheduledGain(gain=np.zeros((2, 2, 1, 1)), starts_s=np.array([[0.0, 1.0]] * 2), schedule="linear")
    assert "linear" in sampled_verdict(two, constant_two(), linear, period_s=0.05).reason


def constant_two() -> SemiMarkov:
    return SemiMarkov(rates=((None, constant_rate(1.0)), (constant_rate(1.0), None)))
