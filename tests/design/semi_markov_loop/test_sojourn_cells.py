"""Loops whose rates change within a period: decided by ages in parts of a period, beside a chain of small steps of time."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from design.controllers.scheduled_gain import constant_gain
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import JumpSystem, sojourn_cells
from design.semi_markov_loop.sampled import sampled_verdict
from design.semi_markov_loop.sojourn_cells import refined
from design.semi_markov_loop.sojourn_renewal import SampledLoop, renewal_radius


def drawn(rng):
    """A loop of two modes whose rates change by a factor of 20 at most within 2 s, sampled at 0.1 to 0.2 s."""
    n = int(rng.integers(1, 3))
    a, b = rng.normal(size=(2, n, n)), rng.normal(size=(2, n, 1))
    gain = rng.normal(size=(2, 1, n)) - 0.7 * np.swapaxes(b, 1, 2)

    def rate():
        nodes = (0.0, float(rng.uniform(0.2, 1.0)), float(rng.uniform(1.0, 2.0)))
        return PiecewiseLinearRate(times_s=nodes, values=tuple(rng.uniform(0.2, 4.0, 3).tolist()))

    process = SemiMarkov(rates=((None, rate()), (rate(), None)))
    tau, d = int(rng.integers(0, 2)), int(rng.integers(0, 2))
    return SampledLoop(
        system=JumpSystem(a=a - 0.3 * np.eye(n), b=b), process=process, gain=constant_gain(gain),
        period_s=float(rng.uniform(0.1, 0.2)), tau=tau, d=d,
    )  # fmt: skip


def by_steps(loop, steps, slots=150):
    """Growth of E z z' per period where modes jump at the ends of small steps only, by their rates at the middle of a step."""
    n, m, D, h = loop.system.states, loop.system.inputs, loop.delay, loop.period_s / steps
    size, ages = n + m * (D + 1), math.ceil(2.0 / h) + 1
    flow, stay = [], []
    for i in range(2):
        generator = np.zeros((size, size))
        generator[:n, :n], generator[:n, size - m :] = loop.system.a[i], loop.system.b[i]
        flow.append(expm(generator * h))
        stay.append(np.exp(-h * loop.process.rate(i, (np.arange(ages) + 0.5) * h).sum(axis=-1)))
    X = np.broadcast_to(np.eye(size - m), (2, ages, size - m, size - m)).copy()
    growth = 0.0
    for _ in range(slots):
        Z = np.zeros((2, ages, size, size))
        for i in range(2):
            take = np.zeros((size, size - m))
            take[:n, :n], take[n : n + m, :n], take[n + m :, n:] = np.eye(n), loop.gain.gain[i, 0], np.eye(size - m - n)
            Z[i] = take @ X[i] @ take.T
        for _ in range(steps):
            moved = np.zeros_like(Z)
            for i in range(2):
                after = flow[i] @ Z[i] @ flow[i].T
                kept = stay[i][:, None, None] * after
                moved[i, 1:] += kept[:-1]
                moved[i, -1] += kept[-1]
                moved[1 - i, 0] += (after - kept).sum(axis=0)
            Z = moved
        X = Z[:, :, : size - m, : size - m]
        total = float(np.trace(X.sum(axis=(0, 1))))
        X, growth = X / total, total
    return growth


def test_what_was_between_the_sides_is_decided_as_small_steps_of_time_say(monkeypatch):
    """Of 40 random loops 6 lie between the sides of whole periods; at 8 cells a period at most two are left, and 0 are false."""
    monkeypatch.setattr(sojourn_cells, "FINEST", 8)
    rng, between, left, compared = np.random.default_rng(21), 0, 0, 0
    for _ in range(40):
        loop = drawn(rng)
        if not renewal_radius(loop, [0, 1], upper=False) < 1.0 < renewal_radius(loop, [0, 1], upper=True):
            continue
        between += 1
        found = refined(loop, [0, 1])
        if found is None:
            left += 1
            continue
        coarse, fine = by_steps(loop, 4, 60), by_steps(loop, 8, 60)
        apart = 3.0 * abs(coarse - fine)
        if abs(fine - 1.0) <= apart:
            continue
        compared += 1
        assert (found.state == "certified") == (fine < 1.0)
        assert fine - apart <= found.growth if found.state == "certified" else fine + apart >= found.growth
    assert between >= 6 and left <= 2 and compared >= 3


def test_both_sides_hold_the_exact_growth_of_constant_rates(monkeypatch):
    """x' = a x in two modes that take turns: the growth per period is that of a matrix of order 2, and soon settles."""
    asked, after = [], sojourn_cells._Side.after
    monkeypatch.setattr(sojourn_cells._Side, "after", lambda side, X: asked.append(0) or after(side, X))
    for fast in (0.2, 1.4):
        a = np.array([[[fast]], [[-1.0]]])
        process = SemiMarkov(rates=((None, constant_rate(1.0)), (constant_rate(2.0), None)))
        loop = SampledLoop(
            system=JumpSystem(a=a, b=np.ones((2, 1, 1))), process=process, gain=constant_gain(np.zeros((2, 1, 1))),
            period_s=0.1, tau=0, d=0,
        )  # fmt: skip
        exact = math.exp(0.1 * np.linalg.eigvals([[2 * fast - 1.0, 2.0], [1.0, -2.0 - 2.0]]).real.max())
        asked.clear()
        found = refined(loop, [0, 1])
        assert found is not None and found.state == ("certified" if exact < 1.0 else "refused")
        assert len(asked) < (600 if exact < 1.0 else 60), "periods that are followed, of at most 400 a search"
        assert (exact <= found.growth < 1.0) if exact < 1.0 else (exact >= found.growth > 1.0)


@pytest.mark.parametrize("shift, state", [(-0.15, "certified"), (0.05, "refused")])
def test_the_pole_that_decides_turns_the_verdict(shift, state):
    """x' = a_i x with rates that fall from 20 to 1 within 0.3 s, sampled at 0.2 s: shifted from the edge by bisection."""
    falling = PiecewiseLinearRate(times_s=(0.0, 0.3), values=(20.0, 1.0))
    process = SemiMarkov(rates=((None, falling), (falling, None)))

    def loop(own):
        system = JumpSystem(a=np.array([[[own]], [[own - 2.0]]]), b=np.ones((2, 1, 1)))
        return SampledLoop(
            system=system, process=process, gain=constant_gain(np.zeros((2, 1, 1))), period_s=0.2, tau=0, d=0
        )  # fmt: skip

    low, high = -1.0, 2.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if by_steps(loop(middle), 8, 40) < 1.0 else (low, middle)
    one = loop(low + shift)
    verdict = sampled_verdict(one.system, process, one.gain, period_s=0.2)
    assert verdict.state == state and "parts of it" in verdict.reason
