"""Wald's test: its operating characteristic, computed exactly, keeps both errors, and it stops early."""

from __future__ import annotations

import math

import numpy as np
import pytest

from design.monte_carlo.confidence import SequentialTest


def characteristic(test: SequentialTest, p: float, most: int) -> tuple[float, float, float]:
    """Return P(decides "at least p1"), P(decides "at most p0") within ``most`` runs, and the mean number of runs, exactly."""
    alive = np.array([1.0])  # probability of every number of successes among the undecided
    high = low = mean = 0.0
    for n in range(1, most + 1):
        alive = np.append(alive * (1 - p), 0.0) + np.insert(alive * p, 0, 0.0)
        for s in np.flatnonzero(alive > 0):
            decided = test.decide(int(s), n)
            if decided is not None:
                high += alive[s] * (decided == "at least p1")
                low += alive[s] * (decided == "at most p0")
                mean += n * alive[s]
                alive[s] = 0.0
    return float(high), float(low), float(mean)


@pytest.mark.parametrize("p0, p1", [(0.5, 0.7), (0.8, 0.9), (0.05, 0.2)])
@pytest.mark.parametrize("alpha, beta", [(0.05, 0.01), (1e-3, 1e-2)])
def test_both_errors_are_kept_exactly(p0: float, p1: float, alpha: float, beta: float) -> None:
    test = SequentialTest(p0=p0, p1=p1, alpha=alpha, beta=beta)
    high, low, _ = characteristic(test, p0, 600)
    assert 0.1 * alpha < high <= alpha and high + low > 0.99, "a wrong pass is as rare as promised, and not much rarer"
    high, low, _ = characteristic(test, p1, 600)
    assert 0.1 * beta < low <= beta and high + low > 0.99


def test_it_errs_less_beyond_its_two_points() -> None:
    test = SequentialTest(p0=0.5, p1=0.7, alpha=0.05, beta=0.05)
    assert characteristic(test, 0.4, 400)[0] < characteristic(test, 0.5, 400)[0]
    assert characteristic(test, 0.8, 400)[1] < characteristic(test, 0.7, 400)[1]


def test_it_needs_fewer_runs_than_a_sample_of_fixed_size() -> None:
    from scipy.stats import binom

    test = SequentialTest(p0=0.8, p1=0.9, alpha=0.01, beta=0.01)
    n = next(n for n in range(1, 2000) if binom.cdf(binom.isf(0.01, n, 0.8), n, 0.9) <= 0.01)
    high, low, mean = characteristic(test, 0.9, 900)
    assert high + low > 0.999 and mean < 0.7 * n


def test_the_fewest_runs_are_those_loop_that_all_succeed() -> None:
    test = SequentialTest(p0=0.95, p1=0.975, alpha=1e-6, beta=1e-6)
    n = math.ceil(math.log(1e6) / math.log(0.975 / 0.95))
    assert test.decide(n, n) == "at least p1" and test.decide(n - 1, n - 1) is None


@pytest.mark.parametrize("field, value", [("p0", 0.0), ("p1", 1.0), ("p1", 0.4), ("alpha", 0.0), ("beta", 1.0)])
def test_numbers_that_mean_nothing_are_refused(field: str, value: float) -> None:
    with pytest.raises(ValueError, match="p1" if field == "p1" else field):
        SequentialTest(**{"p0": 0.5, "p1": 0.7, "alpha": 0.1, "beta": 0.1} | {field: value})
