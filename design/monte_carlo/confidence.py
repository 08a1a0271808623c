"""Confidence intervals for a mean and a standard deviation, and when to stop sampling without spoiling them.

Mean: Student's t. Deviation: from the delta method with the sample's own fourth moment,

    Var(s) ~ s^2 / 4 * ( m_4 / s^4 - (n - 3) / (n - 1) ) / n,

taken on the logarithm, so that the interval stays positive. The chi-square interval of the textbooks holds for normal
samples only, and settling times are not normal.

Stopping: looking again and again at an ordinary 95 % interval and stopping at the first that is narrow enough misses
the truth more often than 5 %. Here the sample is looked at only at n_1 < n_2 < ... (growing by a factor), and look k
uses the error alpha_k = alpha / (k (k + 1)); these sum to alpha. So with probability at least 1 - alpha *all* intervals
hold, the one at which it stops among them, whatever the rule for stopping: the bound is a union bound and needs only that
each single interval has its level (asymptotic in n_k; ``first_look`` keeps n_1 large enough).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from design.errors import FieldError

FloatArray = npt.NDArray[np.float64]
Statistic = Literal["mean", "sd"]


class Interval(NamedTuple):
    """An estimate and the interval that holds the truth with probability ``level``."""

    value: float
    low: float
    high: float
    level: float
    n: int

    @property
    def half_width(self) -> float:
        """Half the length of the interval."""
        return 0.5 * (self.high - self.low)


def mean_interval(values: npt.ArrayLike, level: float = 0.95) -> Interval:
    """Student's interval for the mean of independent values; infinitely wide for fewer than two.

    >>> mean_interval([1.0, 2.0, 3.0])
    Interval(value=2.0, low=-0.48413771175033027, high=4.48413771175033, level=0.95, n=3)
    """
    from scipy.special import stdtrit

    sample = _sample(values, level)
    n, mean = sample.size, float(sample.mean()) if sample.size else math.nan
    if n < 2:
        return Interval(mean, -math.inf, math.inf, level, n)
    half = float(stdtrit(n - 1, 0.5 + 0.5 * level)) * float(sample.std(ddof=1)) / math.sqrt(n)
    return Interval(mean, mean - half, mean + half, level, n)


def deviation_interval(values: npt.ArrayLike, level: float = 0.95) -> Interval:
    """Interval for the standard deviation of independent values of any law with a fourth moment."""
    from scipy.special import ndtri

    sample = _sample(values, level)
    n = sample.size
    if n < 4:
        return Interval(math.nan, 0.0, math.inf, level, n)
    sd = float(sample.std(ddof=1))
    if sd == 0.0:
        return Interval(0.0, 0.0, 0.0, level, n)
    fourth = float(((sample - sample.mean()) ** 4).mean()) / sd**4
    # The sample's fourth moment errs low in small samples, but never below what the inequality of Cauchy allows.
    relative = math.sqrt(max(fourth - (n - 3) / (n - 1), 1.0 / n) / (4.0 * n))
    factor = math.exp(float(ndtri(0.5 + 0.5 * level)) * relative)
    return Interval(sd, sd / factor, sd * factor, level, n)


def _sample(values: npt.ArrayLike, level: float) -> FloatArray:
    if not 0 < level < 1:
        raise FieldError("level", f"{level!r} is not between 0 and 1")
    sample = np.asarray(values, dtype=float)
    if sample.ndim != 1 or not np.isfinite(sample).all():
        raise FieldError("values", "expected finite numbers (leave out or count the runs that have none)")
    return sample


@dataclass(frozen=True, slots=True, kw_only=True)
class StopRule:
    """Stop when the interval of a mean or deviation is narrow enough; see the module's docstring for the error rate.

    Args:
        half_width: wanted half width, in the units of the values.
        statistic: ``mean`` or ``sd``.
        level: probability that the interval at the stop holds the truth, at least.
        first_look: n_1.
        growth: n_{k+1} / n_k.
    """

    half_width: float
    statistic: Statistic = "mean"
    level: float = 0.95
    first_look: int = 100
    growth: float = 1.5

    def __post_init__(self) -> None:
        if not math.isfinite(self.half_width) or self.half_width <= 0:
            raise FieldError("half_width", f"{self.half_width!r} is not positive")
        if self.statistic not in get_args(Statistic):
            raise FieldError("statistic", f"{self.statistic!r} is not one of {get_args(Statistic)}")
        if not 0 < self.level < 1:
            raise FieldError("level", f"{self.level!r} is not between 0 and 1")
        if self.first_look < 30:
            raise FieldError("first_look", f"{self.first_look}, an interval needs at least 30 runs")
        if not self.growth > 1 or not math.isfinite(self.growth):
            raise FieldError("growth", f"{self.growth!r} is not above 1")

    def runs(self, look: int) -> int:
        """Number of runs at a look (1, 2, ...)."""
        return math.ceil(self.first_look * self.growth ** (look - 1))

    def interval(self, values: npt.ArrayLike, look: int) -> Interval:
        """The interval of a look, of level 1 - (1 - level) / (look (look + 1))."""
        level = 1.0 - (1.0 - self.level) / (look * (look + 1))
        return (mean_interval if self.statistic == "mean" else deviation_interval)(values, level)
