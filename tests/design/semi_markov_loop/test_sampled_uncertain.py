"""The Lyapunov function of an uncertain sampled loop: what it decides, and where its inequalities hold."""

from __future__ import annotations

import numpy as np
import pytest
from design.semi_markov_loop.sampled_phase import UncertainProgram, uncertain_decrease

from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.sampled import MARGIN, sampled_verdict
from design.semi_markov_loop.sojourn_renewal import SampledLoop
from design.semi_markov_loop.system import JumpSystem, NormBounded, VertexUncertainty

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
        assert not UncertainProgram(loop(plant(3.0, norm=norm), gain), *shape).program.solve().margin > MARGIN


@pytest.mark.parametrize("schedule", ["hold", "linear"])
@pytest.mark.parametrize("d", [0, 1])
def test_it_falls_at_every_age_phase_rate_and_uncertainty_between_those_that_were_asked(schedule: str, d: int) -> None:
    gain = ScheduledGain(gain=SECTIONS.gain, starts_s=SECTIONS.starts_s, schedule=schedule)
    of = loop(plant(0.4), gain, d)
    program = UncertainProgram(of, 4, 2)
    found = program.program.solve()
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
        holds = [UncertainProgram(loop(plant(0.1), gain), *shape).program.solve().margin > MARGIN for gain in (SECTIONS, bad)]
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
        states.append(UncertainProgram(of, 1, 1).program.solve().margin > MARGIN)
    assert states == [True, False]
