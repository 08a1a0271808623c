"""Whether what a fit leaves is noise: only then do its intervals mean what they say.

    Q = n (n + 2) sum_l r_l^2/(n - l),     chi^2 with as many degrees of freedom as lags

Reference: Ljung and Box, On a measure of lack of fit in time series models, Biometrika 65, 1978.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from scipy.stats import chi2

from design.identification.axis import Array

LAGS = 20
"""Tested at most; of fewer than 1000 samples one in 50: of 100 white ones over 20 lags it would reject 4 of 100, not 1."""
LEVEL = 0.01
EXACT = 1e-9
"""Residuals below this share of the output are rounding, not noise."""

ResidualVerdict = Literal["white", "correlated", "exact"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualTest:
    """The test of one fit.

    Args:
        verdict: ``white``; ``correlated``: the model or the noise is another, the intervals are too narrow; ``exact``:
            there is no noise to be tested.
        statistic: Q.
        lags: how many.
        p_value: of Q, if the residuals are white.
    """

    verdict: ResidualVerdict
    statistic: float
    lags: int
    p_value: float


def residual_test(residuals: Array, size: float) -> ResidualTest:
    """Return the Ljung-Box test of residuals (n,), in order of time.

    Args:
        residuals: measured minus fitted output (n,).
        size: standard deviation of the output, to know rounding from noise.
    """
    n = residuals.size
    lags = min(LAGS, max(n // 50, 1))
    power = float(residuals @ residuals)
    if power <= n * (EXACT * size) ** 2:
        return ResidualTest(verdict="exact", statistic=0.0, lags=lags, p_value=1.0)
    shares = [float(residuals[lag:] @ residuals[:-lag]) / power for lag in range(1, lags + 1)]
    statistic = n * (n + 2) * sum(r * r / (n - lag) for lag, r in enumerate(shares, 1))
    p_value = float(chi2.sf(statistic, lags))
    return ResidualTest(
        verdict="white" if p_value >= LEVEL else "correlated", statistic=float(statistic), lags=lags, p_value=p_value
    )
