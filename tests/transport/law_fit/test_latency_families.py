"""Fits of latencies: each the most likely of its family, and the shares of what was overtaken."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from transport.law_fit.latency_families import LatencyFit, bic, fit_latencies

NONE: NDArray[np.float64] = np.empty(0)


def likelihood(fit: LatencyFit, values: NDArray[np.float64], **changed: float) -> float:
    assert isinstance(fit.spec, dict)
    return float(getattr(stats, fit.name).logpdf(values, **{k: v for k, v in fit.spec.items() if k != "dist"} | changed).sum())


@pytest.mark.parametrize(
    "law",
    [
        stats.gamma(3.0, loc=4e-3, scale=1e-3), stats.lognorm(0.6, scale=4e-3), stats.weibull_min(2.5, loc=3e-3, scale=2e-3),
        stats.expon(scale=2e-3), stats.norm(2e-2, 1e-3), stats.uniform(1e-3, 4e-3),
    ],
)  # fmt: skip
def test_each_fit_is_the_most_likely_of_its_family_and_says_what_it_is(law: Any) -> None:
    """A per cent more or less of any parameter but the threshold makes the record less likely; so does what was overtaken."""
    values = law.rvs(2000, random_state=1)
    fits = fit_latencies(values, NONE)
    scores = [bic(fit.log_likelihood, fit.parameters, len(values)) for fit in fits]
    assert scores == sorted(scores) and law.dist.name in [fit.name for fit in fits[:3]]
    overtaken = np.quantile(values, [0.2, 0.5])
    for fit in fits:
        assert isinstance(fit.spec, dict)
        assert fit.parameters == len(fit.spec.get("table", {**fit.spec, "dist": None}.keys() - {"dist"}))
        if fit.name == "table":
            levels, knots = np.array(fit.spec["table"]).T
            density = np.diff(levels) / np.diff(knots)
            inside = np.clip(np.searchsorted(knots, values, side="right") - 1, 0, len(density) - 1)
            assert len(levels) == 81 and fit.log_likelihood == pytest.approx(np.log(density[inside]).sum())
            assert fit.cdf(knots) == pytest.approx(levels) and fit.below(np.array([0.0, 1.0])).tolist() == [0.0, 1.0]
            continue
        assert fit.log_likelihood == pytest.approx(likelihood(fit, values))
        for name in fit.spec.keys() - {"dist", "loc"}:
            for factor in (0.99, 1.01):
                assert likelihood(fit, values, **{name: factor * fit.spec[name]}) < fit.log_likelihood
        more = [each for each in fit_latencies(values, overtaken) if each.spec == fit.spec]
        later = float(np.log1p(-fit.cdf(overtaken)).sum())
        assert not np.isfinite(later) or more[0].log_likelihood == pytest.approx(fit.log_likelihood + later)


def test_a_threshold_is_where_the_record_is_most_likely() -> None:
    values = stats.gamma(3.0, loc=4e-3, scale=1e-3).rvs(4000, random_state=2)
    fit = next(each for each in fit_latencies(values, NONE) if each.name == "gamma" and each.parameters == 3)
    assert isinstance(fit.spec, dict)
    for loc in np.linspace(0.0, float(values.min()), 40)[:-1]:
        a, _, scale = stats.gamma.fit(values, floc=loc)
        assert stats.gamma.logpdf(values, a, loc, scale).sum() <= fit.log_likelihood + 1e-2


def test_shares_of_what_was_overtaken_go_to_what_is_later() -> None:
    """Remission of leukemia with 6-MP, weeks: survival of Kaplan and Meier as printed in every textbook; each one 20 times."""
    came = np.repeat([6.0, 6.0, 6.0, 7.0, 10.0, 13.0, 16.0, 22.0, 23.0], 20)
    overtaken = np.repeat([6.0, 9.0, 10.0, 11.0, 17.0, 19.0, 20.0, 25.0, 32.0, 32.0, 34.0, 35.0], 20)
    (fit,) = fit_latencies(came, overtaken)
    at = np.array([6.0, 7.0, 10.0, 13.0, 16.0, 22.0])
    assert (1.0 - fit.cdf(at)).round(3).tolist() == [0.857, 0.807, 0.753, 0.69, 0.627, 0.538]
    assert (1.0 - fit.below(at)).round(3).tolist() == [1.0, 0.857, 0.807, 0.753, 0.69, 0.627]
    assert fit.cdf(np.array([5.9, 23.0])).tolist() == [0.0, 1.0] and (fit.name, fit.parameters) == ("table", 6)
    shares = np.diff([0.0, *fit.cdf(np.append(at, 23.0))])
    assert fit.log_likelihood == pytest.approx(20 * np.array([3, 1, 1, 1, 1, 1, 1]) @ np.log(shares))


def test_what_always_takes_the_same_time_has_one_number() -> None:
    (fit,) = fit_latencies(np.full(300, 0.25), NONE)
    assert (fit.name, fit.spec, fit.parameters, fit.log_likelihood) == ("constant", 0.25, 1, 0.0)
    at = np.array([0.2, 0.25, 0.3])
    assert fit.cdf(at).tolist() == [0.0, 1.0, 1.0] and fit.below(at).tolist() == [0.0, 0.0, 1.0]


def test_a_record_in_which_one_value_comes_again_and_again_has_a_table_of_shares() -> None:
    values = np.append(np.full(600, 1e-3), 1e-3 + stats.gamma(2.0, scale=1e-3).rvs(1400, random_state=3))
    (fit,) = [each for each in fit_latencies(values, NONE) if each.name == "table"]
    assert fit.parameters == 1400 and fit.cdf(np.array([1e-3])) == pytest.approx(0.3) and fit.below(np.array([1e-3])) == [0.0]
