"""Intervals and the stopping rule hold the truth as often as they say. Seeds fixed, binomial bounds at 1e-4."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from design.monte_carlo.confidence import Interval, StopRule, deviation_interval, mean_interval

STUDIES = 2000


def fewest_hits(level: float, studies: int) -> int:
    return int(stats.binom.ppf(1e-4, studies, level))


def test_mean_interval_holds_the_mean_of_normal_samples() -> None:
    rng = np.random.default_rng(1)
    found = [mean_interval(rng.normal(3.0, 2.0, 5), 0.9) for _ in range(STUDIES)]
    hits = sum(i.low <= 3.0 <= i.high for i in found)
    assert fewest_hits(0.9, STUDIES) <= hits <= STUDIES - fewest_hits(0.1, STUDIES)


@pytest.mark.parametrize("law", ["normal", "gamma"])
def test_deviation_interval_holds_the_deviation(law: str) -> None:
    rng = np.random.default_rng(2)
    draw = (lambda: rng.normal(0.0, 2.0, 1000)) if law == "normal" else (lambda: rng.gamma(4.0, 1.0, 1000))
    found = [deviation_interval(draw(), 0.95) for _ in range(STUDIES)]
    hits = sum(i.low <= 2.0 <= i.high for i in found)
    assert hits >= fewest_hits(0.94, STUDIES)  # asymptotic: one per cent allowed at n = 1000


def test_chi_square_interval_would_miss_the_deviation_of_a_skewed_law() -> None:
    rng = np.random.default_rng(2)
    low, high = np.sqrt(999 / stats.chi2.ppf([0.975, 0.025], 999))
    sds = np.array([rng.exponential(2.0, 1000).std(ddof=1) for _ in range(STUDIES)])
    assert np.mean((sds * low <= 2.0) & (sds * high >= 2.0)) < 0.8


@pytest.mark.parametrize("statistic", ["mean", "sd"])
def test_interval_at_the_stop_holds_the_truth_as_often_as_promised(statistic: str) -> None:
    rng = np.random.default_rng(3)
    # gamma(4): mean 4, deviation 2. The first look is large enough for the asymptotics of the deviation.
    rule = StopRule(half_width=0.12, statistic=statistic, level=0.95, first_look=300)  # type: ignore[arg-type]
    truth = 4.0 if statistic == "mean" else 2.0
    studies, hits = 600, 0
    for _ in range(studies):
        values, found = np.empty(0), None
        for look in range(1, 40):
            values = np.concatenate([values, rng.gamma(4.0, 1.0, rule.runs(look) - values.size)])
            found = rule.interval(values, look)
            if found.half_width <= rule.half_width:
                break
        assert found is not None and found.half_width <= 0.12
        hits += found.low <= truth <= found.high
    assert hits >= fewest_hits(0.95, studies)


def test_stopping_at_the_first_narrow_ordinary_interval_misses_more_often() -> None:
    # Why the rule spends its error: looking after every run from 30 on, a small first look and no correction.
    rng = np.random.default_rng(4)
    studies, hits = 1000, 0
    for _ in range(studies):
        x = rng.exponential(1.0, 4000)
        n = np.arange(1, x.size + 1)
        mean = np.cumsum(x) / n
        sd = np.sqrt(np.maximum(np.cumsum(x * x) / n - mean**2, 0.0))
        half = 1.96 * sd / np.sqrt(n)
        stop = 29 + int(np.argmax(half[29:] <= 0.25))
        hits += abs(mean[stop] - 1.0) <= half[stop]
    assert hits < fewest_hits(0.95, studies)


def test_too_few_values_give_no_narrow_interval() -> None:
    assert mean_interval([1.0]).half_width == np.inf
    assert deviation_interval([1.0, 2.0, 3.0]).high == np.inf
    assert deviation_interval([2.0] * 9) == Interval(0.0, 0.0, 0.0, 0.95, 9)


@pytest.mark.parametrize(
    ("field", "value"), [("half_width", 0.0), ("statistic", "median"), ("level", 1.0), ("first_look", 5), ("growth", 1.0)]
)
def test_a_rule_that_cannot_be_is_refused(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{field}: "):
        StopRule(**({"half_width": 1.0} | {field: value}))  # type: ignore[arg-type]


def test_values_that_are_missing_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^values: "):
        mean_interval([1.0, np.inf])
