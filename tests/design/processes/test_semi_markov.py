"""Semi-Markov processes: the next jump is drawn from its exact law, whatever the rates. Seeds fixed, level 1e-3."""

from __future__ import annotations

import math
from itertools import pairwise, starmap

import numpy as np
import pytest
from scipy import stats

from design.processes.further_rates import BathtubRate, ColdStandbyRate, KOutOfNRate, UserRate
from design.processes.rates import PiecewiseLinearRate, ScaledRate, WeibullRate, clip_rate, constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov, sample_fault_detection, sample_path

LEVEL = 1e-3
BATHTUB = BathtubRate(infant=3.0, infant_time_s=0.4, useful=0.2, wear=1.5, wear_start_s=0.6, wear_span_s=2.0)
STEP = PiecewiseLinearRate(times_s=(0.0, 0.5, 0.5), values=(0.4, 0.4, 6.0))
PROCESS = SemiMarkov(
    rates=(
        (None, BATHTUB, clip_rate(0.1, 4.6), constant_rate(0.5)),
        (clip_rate(0.1, 4.6), None, STEP, None),
        (WeibullRate(scale_s=1.0, shape=0.7), ColdStandbyRate(installed=2, rate=3.0), None, None),
        (constant_rate(2.0), None, None, None),
    )
)
USER = UserRate(function=lambda h: 1.0 + 0.5 * h / (1.0 + h), lower=1.0, upper=1.5, horizon_s=3.0)
AGEING = SemiMarkov(
    rates=(
        (None, KOutOfNRate(needed=2, installed=4, rate=0.8), ScaledRate(rate=WeibullRate(scale_s=2.0, shape=1.3), factor=0.7)),
        (USER, None, ColdStandbyRate(installed=9, rate=4.0)),
        (constant_rate(1.0), BATHTUB, None),
    )
)


@pytest.mark.parametrize("mode", range(4))
def test_sojourn_follows_its_law_and_targets_follow_the_rates(mode: int) -> None:
    rng = np.random.default_rng(17 + mode)
    h, target = PROCESS.next_jump(np.full(40_000, mode), rng)
    assert stats.kstest(-np.expm1(-PROCESS.integral(mode, h)), "uniform").pvalue > LEVEL
    # within bins of h the targets must occur as often as their share of the total rate says
    bins = np.quantile(h, np.linspace(0, 1, 7))
    shares = PROCESS.rate(mode, h) / PROCESS.rate(mode, h).sum(axis=-1, keepdims=True)
    for low, high in pairwise(bins):
        here = (h >= low) & (h < high)
        for j in PROCESS.targets(mode):
            p = shares[here, j]
            if len(PROCESS.targets(mode)) > 1:
                score = ((target[here] == j) - p).sum() / math.sqrt((p * (1 - p)).sum())
                assert abs(score) < stats.norm.isf(LEVEL / 60)
    assert set(np.unique(target)) <= set(PROCESS.targets(mode))


@pytest.mark.parametrize("mode", range(4))
def test_jump_given_the_age_is_the_conditional_law(mode: int) -> None:
    h, _ = PROCESS.next_jump(np.full(20_000, mode), np.random.default_rng(3), age=0.45)
    assert h.min() > 0.45
    survival = PROCESS.integral(mode, h) - PROCESS.integral(mode, 0.45)
    assert stats.kstest(survival, "expon").pvalue > LEVEL


@pytest.mark.parametrize("mode", range(4))
def test_inversion_is_exact_to_rounding(mode: int) -> None:
    target = np.concatenate([[0.0], np.geomspace(1e-12, 45, 400)])
    h = PROCESS.sojourn(mode, target)
    assert PROCESS.integral(mode, h) == pytest.approx(target, rel=1e-13, abs=1e-15)
    assert (np.diff(h) > 0).all()


def test_fixed_steps_would_be_biased_where_inversion_is_not() -> None:
    # the exact mean int exp(-H) against the inversion; a Bernoulli draw per 0.1 s misses it by far more than the error
    rng = np.random.default_rng(5)
    grid = np.linspace(0, 15, 300_001)
    exact = np.trapezoid(np.exp(-PROCESS.integral(0, grid)), grid)
    h, _ = PROCESS.next_jump(np.zeros(100_000, dtype=int), rng)
    error = h.std() / math.sqrt(h.size)
    assert abs(h.mean() - exact) < stats.norm.isf(LEVEL / 2) * error
    step = 0.1
    stay = np.concatenate(
        [[1.0], np.cumprod(1 - np.minimum(PROCESS.rate(0, np.arange(0, 15, step)).sum(-1) * step, 1))]
    )
    assert abs(step * stay.sum() - exact) > 10 * error


def test_a_mode_without_exit_never_jumps_and_a_dying_rate_may_not() -> None:
    fading = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(1.0, 0.0))
    process = SemiMarkov(rates=((None, fading), (None, None)))
    h, target = process.jump(np.array([0, 0, 1]), 0.0, np.array([0.3, 0.7, 0.1]), np.zeros(3))
    assert np.isfinite(h).tolist() == [True, False, False]
    assert target.tolist() == [1, 0, 1]


@pytest.mark.parametrize("process", [PROCESS, AGEING], ids=["shapes", "ageing"])
def test_same_draws_give_same_jumps_however_the_runs_are_split(process: SemiMarkov) -> None:
    rng = np.random.default_rng(1)
    mode, e, u = rng.integers(0, 4, 1000), rng.standard_exponential(1000), rng.random(1000)
    age = np.where(rng.random(1000) < 0.5, 0.0, rng.random(1000))
    h, target = process.jump(mode % process.modes, age, e, u)
    for edges in ((0, 137, 1000), (0, 1, 2, 3, 500, 999, 1000), (0, *range(5, 1000, 7), 1000)):
        parts = [process.jump(mode[s] % process.modes, age[s], e[s], u[s]) for s in starmap(slice, pairwise(edges))]
        assert np.array_equal(h, np.concatenate([p[0] for p in parts]))
        assert np.array_equal(target, np.concatenate([p[1] for p in parts]))


def test_path_of_two_clocks_restarts_what_its_field_says() -> None:
    failure = SemiMarkov(rates=((None, constant_rate(2.0)), (constant_rate(2.0), None)))
    slow = SemiMarkov(rates=((None, clip_rate(0.1, 3.0)), (clip_rate(0.1, 3.0), None)))
    quick = SemiMarkov(rates=((None, clip_rate(1.0, 9.0)), (clip_rate(1.0, 9.0), None)))
    for restarts in (False, True):
        process = FaultDetection(failure=failure, detection=(slow, quick), failure_restarts_detection_clock=restarts)
        eta, r = sample_fault_detection(process, 0, 0, 200.0, np.random.default_rng(2))
        assert bool(np.isin(eta.times_s, r.times_s).all()) is restarts
        assert (np.diff(r.times_s) > 0).all() and (np.diff(eta.modes) != 0).all()
    with pytest.raises(TypeError):
        FaultDetection(failure=failure, detection=(slow, quick))  # type: ignore[call-arg]


def test_detection_under_both_reset_rules_has_the_right_hazard() -> None:
    # A rate that is zero before 1 s: eta jumps every 0.5 s on average, so a restarted clock of r rarely gets there.
    failure = SemiMarkov(rates=((None, constant_rate(2.0)), (constant_rate(2.0), None)))
    late = PiecewiseLinearRate(times_s=(0.0, 1.0, 1.0), values=(0.0, 0.0, 5.0))
    detection = SemiMarkov(rates=((None, late), (late, None)))
    jumps = []
    for restarts in (False, True):
        process = FaultDetection(
            failure=failure, detection=(detection, detection), failure_restarts_detection_clock=restarts
        )
        _, r = sample_fault_detection(process, 0, 0, 600.0, np.random.default_rng(4))
        jumps.append(int(np.count_nonzero(np.diff(r.modes))))
    # own clock: mean sojourn 1 + 1/5 s; restarted: waits for a gap > 1 s of a Poisson process, (e^2 - 1)/2 s
    assert jumps[0] == pytest.approx(600 / 1.2, abs=4 * math.sqrt(600 / 1.2) * 0.2)
    assert jumps[1] < 0.35 * jumps[0]


def test_path_states_mode_and_sojourn_time() -> None:
    path = sample_path(PROCESS, 0, 50.0, np.random.default_rng(0))
    mode, h = path.at(path.times_s[3] + 1e-9)
    assert int(mode) == path.modes[3] and float(h) == pytest.approx(1e-9, rel=1e-3)


@pytest.mark.parametrize(
    ("rates", "message"),
    [
        ((), "rates: expected at least one mode"),
        (((None, constant_rate(1.0)),), r"rates\[0\]: 2 entries, expected 1"),
        (((constant_rate(1.0), None), (None, None)), r"rates\[0\]\[0\]: the diagonal"),
        (((None, 3.0), (None, None)), r"rates\[0\]\[1\]: 3.0 is not a rate"),
    ],
)
def test_bad_process_is_refused(rates: object, message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        SemiMarkov(rates=rates)  # type: ignore[arg-type]
