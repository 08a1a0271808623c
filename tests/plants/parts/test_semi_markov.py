"""Semi-Markov jumps are drawn from the law that their rates state. Fixed seeds; each test errs with probability 0.001."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from plants.parts.flow import HeldNoise, JumpProcess, _Hazard, pass_time
from plants.parts.semi_markov import TransitionRates

LEVEL = 0.001
CLIPPED = TransitionRates.clipped(low=0.1, high=4.6)
THREE = TransitionRates(
    nodes_s=(0.0, 0.5, 1.5),
    rates=(
        ((-2.0, 2.0, 0.0), (0.3, -0.4, 0.1), (1.0, 1.0, -2.0)),
        ((-0.2, 0.1, 0.1), (1.0, -4.0, 3.0), (0.0, 0.0, 0.0)),
        ((-3.0, 1.0, 2.0), (0.5, -1.0, 0.5), (2.0, 1.0, -3.0)),
    ),
)


def survival(rates, mode, h):
    """exp(-int_0^h lambda), by the trapezoidal rule, which is exact for these rates on a grid that has their nodes."""
    grid = np.union1d(np.linspace(0.0, h, 50), [t for t in rates.nodes_s if t < h])
    return math.exp(-np.trapezoid([sum(rates.at(mode, s)) for s in grid], grid))


def sojourns(rates, mode, count, seed):
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        process = JumpProcess(rates, mode, rng)
        h = process.next_ns * 1e-9
        process.fire()
        found.append((h, process.mode))
    return found


@pytest.mark.parametrize(("rates", "mode"), [(CLIPPED, 1), (THREE, 1), (THREE, 2), (THREE, 3)])
def test_sojourn_times_follow_the_rates(rates, mode):
    # 1 - exp(-H) of a sojourn time is uniform
    uniform = [1.0 - survival(rates, mode, h) for h, _ in sojourns(rates, mode, 800, seed=mode)]
    assert stats.kstest(uniform, "uniform").pvalue > LEVEL


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_targets_follow_the_rates_at_the_jump(mode):
    expected, hits, variance = 0.0, 0, 0.0
    for h, target in sojourns(THREE, mode, 3000, seed=10 + mode):
        rates = THREE.at(mode, h)
        first = 1 if mode > 1 else 2
        p = rates[first - 1] / sum(rates)
        expected, hits, variance = expected + p, hits + (target == first), variance + p * (1 - p)
        assert target != mode
        assert rates[target - 1] > 0.0
    assert abs(hits - expected) < stats.norm.isf(LEVEL / 2) * math.sqrt(variance)


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("change", [0.4, 1.5])
def test_a_change_of_rates_on_the_way_gives_the_law_of_the_joined_rates(restart, change):
    """lambda(h) of the first table up to the change, from there lambda of the second one, at the same clock or a new one.

    Error rate LEVEL per case. Power: until 1.5 s 1.1 of an exponential is used up, so that giving it back instead of
    taking it off moves the law by more than 0.1, which 1,000 samples see at this level but for one time in 10^6.
    """
    rng, uniform, change_ns = np.random.default_rng(5), [], round(change * 1e9)
    for _ in range(1000):
        process = JumpProcess(CLIPPED, 1, rng)
        if process.next_ns > change_ns:
            process.change_rates(THREE_OF_TWO, change_ns, restart=restart)
            h = process.next_ns * 1e-9
            start = 0.0 if restart else change
            later = survival(THREE_OF_TWO, 1, h - change + start) / (survival(THREE_OF_TWO, 1, start) if start else 1.0)
            left = survival(CLIPPED, 1, change) * later
        else:
            left = survival(CLIPPED, 1, process.next_ns * 1e-9)
        uniform.append(1.0 - left)
    assert stats.kstest(uniform, "uniform").pvalue > LEVEL


THREE_OF_TWO = TransitionRates(nodes_s=(0.0, 1.0), rates=(((-3.0, 3.0), (1.0, -1.0)), ((-0.5, 0.5), (1.0, -1.0))))


@settings(deadline=None)
@given(st.sampled_from([(CLIPPED, 1), (THREE, 1), (THREE, 2), (THREE, 3)]), st.floats(1e-9, 50.0))
def test_the_inverse_hazard_inverts_the_hazard(law, area):
    hazard = _Hazard(*law)
    assert hazard.integral(hazard.inverse(area)) == pytest.approx(area, rel=1e-12)


def test_a_mode_without_a_way_out_never_ends():
    never = TransitionRates(nodes_s=(0.0,), rates=(((0.0, 0.0), (1.0, -1.0)),))
    assert JumpProcess(never, 1, np.random.default_rng(0)).next_ns > 10**18


def test_rates_that_end_leave_a_mode_only_with_the_probability_of_their_area():
    """Rate 1 for one second, then none: the mode is left with probability 1 - exp(-1)... and else never."""
    pulse = TransitionRates(
        nodes_s=(0.0, 1.0, 1.001), rates=(((-1.0, 1.0), (0.0, 0.0)), ((-1.0, 1.0), (0.0, 0.0)), ((0.0, 0.0), (0.0, 0.0)))
    )
    rng = np.random.default_rng(3)
    left = sum(JumpProcess(pulse, 1, rng).next_ns < 10**18 for _ in range(1000))
    assert stats.binomtest(left, 1000, 1.0 - math.exp(-1.0005)).pvalue > LEVEL


def test_clipped_rates_are_the_ones_of_2_26():
    for h, rate in ((0.0, 0.1), (0.05, 0.1), (0.1, 0.1), (2.0, 2.0), (4.6, 4.6), (100.0, 4.6)):
        assert CLIPPED.at(1, h) == pytest.approx((0.0, rate))
        assert CLIPPED.at(2, h) == pytest.approx((rate, 0.0))
    assert TransitionRates.clipped(low=0.0, high=100.0, slope=2.0).at(1, 0.25) == pytest.approx((0.0, 0.5))


@pytest.mark.parametrize(
    ("nodes_s", "rates", "message"),
    [
        ((), (), "nodes_s: (), expected nodes that start at 0"),
        ((1.0,), (((0.0,),),), "nodes_s: (1.0,), expected nodes that start at 0"),
        ((0.0, 0.0), (((0.0,),),) * 2, "nodes_s[1]: 0.0, expected more than nodes_s[0] (0.0)"),
        ((0.0, math.nan), (((0.0,),),) * 2, "nodes_s[1]: nan, expected a finite number"),
        ((0.0,), (), "rates: 0 matrices, expected one for each of 1 nodes"),
        ((0.0,), ((),), "rates[0]: 0 rows, expected 1"),
        ((0.0,), (((-1.0, 1.0), (1.0,)),), "rates[0][1]: 1 entries, expected 2"),
        ((0.0,), (((-1.0, 1.0), (0.5, -0.4)),), "rates[0][1]: row sums to 0.1, expected 0"),
        ((0.0,), (((1.0, -1.0), (1.0, -1.0)),), "rates[0][0][1]: -1.0, expected a finite number >= 0"),
    ],
)
def test_tables_that_are_no_rates_are_refused_by_entry(nodes_s, rates, message):
    with pytest.raises(ValueError) as fault:
        TransitionRates(nodes_s=nodes_s, rates=rates)
    assert str(fault.value) == message


def test_a_toml_table_becomes_rates():
    table = {"nodes_s": [0.0, 1.0], "rates": [[[-1.0, 1.0], [2.0, -2.0]], [[-2.0, 2.0], [0.0, 0.0]]]}
    assert msgspec.convert(table, TransitionRates).at(1, 0.5) == (0.0, 1.5)


class Beat:
    def __init__(self, name, period_ns, log):
        self.name, self.period_ns, self.next_ns, self.log = name, period_ns, period_ns, log

    def fire(self):
        self.log.append((self.name, self.next_ns))
        self.next_ns += self.period_ns


@settings(deadline=None)
@given(st.lists(st.integers(0, 30), min_size=1, max_size=6))
def test_events_come_in_order_and_time_is_covered_once(cuts):
    log, pieces = [], []
    sources = [Beat("a", 6, log), Beat("b", 9, log)]
    now = 0
    for cut in cuts:
        pass_time(now, now + cut, sources, lambda a, b: pieces.append((a, b)))
        now += cut
    assert log == sorted(log, key=lambda e: (e[1], e[0]))
    assert len(log) == now // 6 + now // 9  # an event at the very end has happened
    assert [a for a, _ in pieces] == ([0] + [b for _, b in pieces])[: len(pieces)]
    assert sum(b - a for a, b in pieces) == now
    assert all(b > a for a, b in pieces)


def test_noise_is_white_and_has_its_deviation():
    noise = HeldNoise(2, 0.5, 1000, np.random.default_rng(8))
    samples = [noise.values]
    for _ in range(3999):
        noise.fire()
        samples.append(noise.values)
    assert noise.next_ns == 4_000_000
    samples = np.array(samples)
    assert stats.kstest(samples.ravel() / 0.5, "norm").pvalue > LEVEL
    lag = np.corrcoef(samples[1:, 0], samples[:-1, 0])[0, 1], np.corrcoef(samples.T)[0, 1]
    assert np.abs(lag).max() < stats.norm.isf(LEVEL / 4) / math.sqrt(4000)


def test_noise_of_no_deviation_draws_nothing():
    rng = np.random.default_rng(8)
    noise = HeldNoise(2, 0.0, 1000, rng)
    assert noise.values == (0.0, 0.0)
    assert noise.next_ns > 10**18
    assert rng.random() == np.random.default_rng(8).random()
