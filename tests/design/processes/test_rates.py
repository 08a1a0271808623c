"""Rates: values, integrals, bounds, and the one message that a bad one gets."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import betainc, gammaincc

from design.processes.further_rates import BathtubRate, ColdStandbyRate, KOutOfNRate, UserRate
from design.processes.rates import PiecewiseLinearRate, Rate, ScaledRate, TendingRate, WeibullRate, clip_rate, constant_rate

STEP = PiecewiseLinearRate(times_s=(0.0, 0.5, 0.5), values=(0.01, 0.01, 20.0))
BATHTUB = BathtubRate(infant=3.0, infant_time_s=0.4, useful=0.2, wear=1.5, wear_start_s=0.6, wear_span_s=2.0)
RATES: dict[str, Rate] = {
    "constant": constant_rate(0.7),
    "clip": clip_rate(np.float64(0.1), 4.6),
    "step": STEP,
    "weibull": WeibullRate(scale_s=1.3, shape=2.0),
    "bathtub": BATHTUB,
    "two of three": KOutOfNRate(needed=2, installed=3, rate=0.8),
    "one of two": KOutOfNRate(needed=1, installed=2, rate=0.8),
    "cold standby": ColdStandbyRate(installed=3, rate=1.1),
    "user": UserRate(function=lambda h: 1.0 + np.sin(3 * h), lower=0.0, upper=2.0, horizon_s=2.0),
    "scaled": ScaledRate(rate=clip_rate(0.1, 4.6), factor=0.3),
}


@pytest.mark.parametrize("name", RATES)
def test_integral_is_the_integral_of_the_rate(name: str) -> None:
    rate = RATES[name]
    for h in (0.0, 0.3, 1.0, 2.7, 6.0):
        edges = [0.0, *(b for b in rate.breaks if b < h), *([2.0] if name == "user" and h > 2 else []), h]
        expected = sum(quad(lambda s: float(rate(s)), a, b, epsabs=1e-12)[0] for a, b in pairwise(edges))
        assert float(rate.integral(h)) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("name", RATES)
def test_bounds_hold_everywhere_and_are_reached(name: str) -> None:
    rate = RATES[name]
    for start, stop in ((0.0, 0.4), (0.2, 1.7), (0.5, 3.0), (0.45, 0.5), (2.5, math.inf)):
        low, high = rate.bounds(start, stop)
        values = rate(np.linspace(start, min(stop, 60.0), 4001)[:-1])
        assert low <= values.min() + 1e-12 and high >= values.max() - 1e-12
        if name != "user":  # the user's bounds are a promise for all h
            assert values.min() - low < 1e-2 and (high - values.max() < 1e-2 or stop == math.inf)


@pytest.mark.parametrize("name", RATES)
def test_rate_is_constant_once_settled(name: str) -> None:
    rate = RATES[name]
    if math.isfinite(rate.settled):
        after = rate(rate.settled + np.array([0.0, 1.0, 50.0]))
        assert np.ptp(after) == 0.0
        assert rate.bounds(rate.settled, math.inf) == pytest.approx((after[0], after[0]))


def test_redundant_lifetimes_have_the_known_means_and_limits() -> None:
    # mean of k-out-of-n: sum_{j=k}^n 1/(j c); hazard of 1-of-2: 2c(1-p)/(2-p); both tend to k c
    for k, n in ((1, 2), (1, 3), (2, 3), (2, 2)):
        law = KOutOfNRate(needed=k, installed=n, rate=0.5)
        mean = quad(lambda h, law=law: np.exp(-float(law.integral(h))), 0, 200)[0]
        assert mean == pytest.approx(sum(1 / (j * 0.5) for j in range(k, n + 1)), rel=1e-7)
        assert float(law(500.0)) == pytest.approx(k * 0.5)
        works = betainc(k, n - k + 1, np.exp(-0.5 * np.array([0.3, 4.0])))
        assert np.exp(-law.integral([0.3, 4.0])) == pytest.approx(works)
    p = math.exp(-0.5)
    assert float(KOutOfNRate(needed=1, installed=2, rate=0.5)(1.0)) == pytest.approx(2 * 0.5 * (1 - p) / (2 - p))
    standby = ColdStandbyRate(installed=2, rate=0.5)
    assert quad(lambda h: np.exp(-float(standby.integral(h))), 0, 200)[0] == pytest.approx(4.0, rel=1e-7)
    assert np.exp(-standby.integral([0.0, 4.0])) == pytest.approx(gammaincc(2, [0.0, 2.0]))


def test_weibull_of_scale_1_and_shape_2_is_2h_and_not_h() -> None:
    # DEVIATION of the text above (2.26), which says h; the median of 2h is the printed section boundary 0.8326.
    rate = WeibullRate(scale_s=1.0, shape=2.0)
    assert float(rate(1.7)) == pytest.approx(3.4)
    assert float(rate.integral(0.8326)) == pytest.approx(math.log(2), abs=2e-4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: constant_rate(-1.0), r"values\[0\]: -1.0"),
        (lambda: constant_rate(math.nan), r"values\[0\]: nan"),
        (lambda: clip_rate(2.0, 1.0), "upper: 1.0 is not above lower = 2.0: the rate crosses its bounds"),
        (lambda: clip_rate(0.1, 1.0, slope=0.0), "slope: 0.0"),
        (
            lambda: PiecewiseLinearRate(times_s=(0.0, 2.0, 1.0), values=(1.0, 1.0, 1.0)),
            "times_s: expected finite nodes",
        ),
        (lambda: PiecewiseLinearRate(times_s=(0.0, 1.0), values=(1.0,)), "values: 1 values for 2 nodes"),
        (lambda: WeibullRate(scale_s=0.0, shape=2.0), "scale_s: 0.0"),
        (lambda: KOutOfNRate(needed=3, installed=2, rate=1.0), "needed: 3 of 2 components"),
        (
            lambda: UserRate(function=lambda h: h, lower=0.0, upper=1.0, horizon_s=2.0),
            r"function: 1.00\d+ at h = 1.00\d+ s is outside",
        ),
        (lambda: UserRate(function=np.log, lower=0.0, upper=1.0, horizon_s=2.0), "function: -inf at h = 0 s"),
        (lambda: UserRate(function=lambda h: h, lower=1.0, upper=0.0, horizon_s=2.0), "upper: 0.0 is below lower"),
    ],
)
def test_bad_rate_is_refused_with_its_field_first(make: object, message: str) -> None:
    with np.errstate(divide="ignore"), pytest.raises(ValueError, match="^" + message):
        make()  # type: ignore[operator]


LIMITS = [
    (PiecewiseLinearRate(times_s=(0.0, 2.0), values=(1.0, 3.0)), 3.0), (WeibullRate(scale_s=4.0, shape=1.0), 0.25),
    (WeibullRate(scale_s=4.0, shape=0.5), 0.0), (WeibullRate(scale_s=4.0, shape=2.0), math.inf),
    (KOutOfNRate(needed=2, installed=3, rate=0.5), 1.0), (ColdStandbyRate(installed=2, rate=0.5), 0.5),
    (UserRate(function=np.sqrt, lower=0.0, upper=2.0, horizon_s=4.0), 2.0), (BATHTUB, 3.2),
]  # fmt: skip


@pytest.mark.parametrize(("rate", "limit"), LIMITS, ids=repr)
def test_a_rate_says_where_it_tends_to_and_a_share_of_it_where_that_does(rate: Rate, limit: float) -> None:
    assert isinstance(rate, TendingRate) and rate.limit == limit
    assert ScaledRate(rate=rate, factor=0.3).limit == 0.3 * limit
    if limit not in (0.0, math.inf):
        assert float(rate(1e4)) == pytest.approx(limit, rel=1e-3)


def test_a_share_of_a_rate_that_says_no_limit_has_none_that_is_known() -> None:
    class Stranger:
        def __call__(self, h: object) -> object:
            return h

    assert math.isnan(ScaledRate(rate=Stranger(), factor=0.3).limit)  # type: ignore[arg-type]
