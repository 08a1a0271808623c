"""What a sample of runs shows, with a stated error: confidence intervals, when to stop, and a sequential test of a probability.

Mean: Student's t with Hall's correction for skewness. With g the sample's skewness and a = g / sqrt(n),

    T -> ((1 + a T / 3)^3 - 1) / a + a / 6

is closer to symmetric than T = sqrt(n) (mean - mu) / s; the interval is its inverse of -t and t. Without skewness it is
Student's. It misses more than it says where the sample is too small for its tails: of lognormal (sigma = 1) samples one in seven
for n = 5, one in fifteen for n = 100. Paired difference: Student's t alone, for the difference of two runs of one law is
symmetric; where only the means are the same it misses more: one in eight of an exponential against a constant, n = 5. Their
ratio: Fieller's set, which holds 1 exactly where the interval of the difference holds 0.

Equal values have no spread to judge by: of a number that is 1 in one run of twenty, ten runs in a row have 0 in six of ten cases.
So the interval of their mean is infinitely wide. Equal differences are taken as they are from `EQUAL` pairs on, for of a
symmetric law so many have one sign with 2^(1 - n), 3 %; fewer show nothing.

Deviation: Bonett's interval, with a kurtosis k about a trimmed mean. No interval covers where the tail is not in the sample, so
none is given (it is infinitely wide) where k > sqrt(n) / 2: the sample is too small for its tails. Of normal, exponential and
lognormal (sigma = 1) samples of any size at most one in sixteen gets an interval that misses; symmetric tails without a fourth
moment (Student's t with 3 degrees of freedom) are not seen so, and miss in one of five.

Stopping: looking again and again at an ordinary 95 % interval and stopping at the first that is narrow enough misses
the truth more often than 5 %. Here the sample is looked at only at n_1 < n_2 < ... (growing by a factor), and look k
uses the error alpha_k = alpha / (k (k + 1)); these sum to alpha. So with probability at least 1 - alpha *all* intervals
hold, the one at which it stops among them, whatever the rule for stopping: the bound is a union bound and needs only that
each single interval has its level (asymptotic in n_k; ``first_look`` keeps n_1 large enough). Of a deviation it has where the
sample shows its tails, and a narrow one is likely where it does not: of lognormal samples that stopped at a half width of 0.2 or
0.3 deviations one in seven missed, of exponential ones one in seventeen.

Reference: P. Hall, "On the removal of skewness by transformation", J. R. Statist. Soc. B 54 (1992) 221-228. D. G. Bonett,
"Approximate confidence interval for standard deviation of nonnormal distributions", Comput. Stat. Data Anal. 50 (2006) 775-782.
E. C. Fieller, "Some problems in interval estimation", J. R. Statist. Soc. B 16 (1954) 175-185.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.errors import FieldError, check_above_zero

FloatArray = npt.NDArray[np.float64]
Statistic = Literal["mean", "sd"]


SMALLEST = 10
"""Values below which no interval of a deviation is given."""
EQUAL = 6
"""Differences below which equal ones show nothing."""
ROUNDING = 1e-12
"""Share of its size by which rounding may change a value."""


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

    @property
    def bounded(self) -> bool:
        """Whether the sample gives an interval: both ends are finite."""
        return math.isfinite(self.half_width)


def mean_interval(values: npt.ArrayLike, level: float = 0.95) -> Interval:
    """Interval for the mean of independent values, see the module; infinitely wide for fewer than two and for equal ones.

    >>> mean_interval([1.0, 2.0, 3.0])
    Interval(value=2.0, low=-0.484..., high=4.484..., level=0.95, n=3)
    """
    sample = _sample(values, level)
    n, mean = sample.size, float(sample.mean()) if sample.size else math.nan
    if n < 2 or _equal(sample):
        return Interval(mean, -math.inf, math.inf, level, n)
    sd, t = float(sample.std(ddof=1)), _student(n, level)
    error = sd / math.sqrt(n)
    skew = float((((sample - mean) / sd) ** 3).mean()) / math.sqrt(n) if sd > 0.0 else 0.0
    return Interval(mean, mean - error * _unskewed(t, skew), mean - error * _unskewed(-t, skew), level, n)


def _unskewed(t: float, a: float) -> float:
    """Inverse of Hall's transformation, a = skewness / sqrt(n)."""
    if abs(a) < 1e-6:
        return t
    return 3.0 / a * (math.cbrt(1.0 + a * (t - a / 6.0)) - 1.0)


def difference_interval(a: npt.ArrayLike, b: npt.ArrayLike, level: float = 0.95) -> Interval:
    """Student's interval for the mean of b - a, pair by pair; infinitely wide for fewer than two pairs, or `EQUAL` equal ones.

    >>> difference_interval([1.0, 2.0, 3.0], [2.0, 3.0, 4.0])
    Interval(value=1.0, low=-inf, high=inf, level=0.95, n=3)
    >>> difference_interval([1.0] * 6, [2.0] * 6)
    Interval(value=1.0, low=1.0, high=1.0, level=0.95, n=6)
    """
    first, second = _sample(a, level), _sample(b, level)
    gap = second - first
    n, mean = gap.size, float(gap.mean()) if gap.size else math.nan
    if n < 2 or (n < EQUAL and _equal(gap, float(np.abs([first, second]).max()))):
        return Interval(mean, -math.inf, math.inf, level, n)
    half = _student(n, level) * float(gap.std(ddof=1)) / math.sqrt(n)
    return Interval(mean, mean - half, mean + half, level, n)


def ratio_interval(a: npt.ArrayLike, b: npt.ArrayLike, level: float = 0.95) -> Interval:
    """Fieller's interval for mean(b) / mean(a), pairs dependent: all q for which b - q a may have the mean 0.

    Infinitely wide where that of the difference is, and where mean(a) may be 0.

    >>> ratio_interval([9.0, 10.0, 11.0], [18.0, 20.0, 22.0])
    Interval(value=2.0, low=2.0, high=2.0, level=0.95, n=3)
    """
    first, second = _sample(a, level), _sample(b, level)
    n = first.size
    if not difference_interval(a, b, level).bounded or first.mean() == 0.0:
        return Interval(math.nan, -math.inf, math.inf, level, n)
    q = float(second.mean() / first.mean())
    rest = second - q * first  # of mean 0: the set is that of x = q' - q with |x mean(a)| <= t sd(rest - x a) / sqrt(n)
    share = _student(n, level) ** 2 / n
    r, f = rest - rest.mean(), first - first.mean()
    v_rest, cov, v_first = (float((one * other).sum()) / (n - 1) for one, other in ((r, r), (r, f), (f, f)))
    square = float(first.mean()) ** 2 - share * v_first
    if square <= 0.0:
        return Interval(q, -math.inf, math.inf, level, n)
    middle = -share * cov / square
    half = math.sqrt(max(middle**2 + share * v_rest / square, 0.0))
    return Interval(q, q + middle - half, q + middle + half, level, n)


def _equal(sample: FloatArray, size: float = 0.0) -> bool:
    """Whether values are the same up to rounding, differences of values up to a size too."""
    return bool(np.ptp(sample) <= ROUNDING * max(size, float(np.abs(sample).max())))


def _student(n: int, level: float) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(n - 1, 0.5 + 0.5 * level))


def deviation_interval(values: npt.ArrayLike, level: float = 0.95) -> Interval:
    """Interval for the standard deviation of independent values; infinitely wide for equal ones, and too few for their tails."""
    from scipy.special import ndtri  # not scipy.stats: half a second of CPU at the start of a command

    sample = _sample(values, level)
    n = sample.size
    sd = float(sample.std(ddof=1)) if n > 1 else math.nan
    if n < SMALLEST or _equal(sample):
        return Interval(sd, 0.0, math.inf, level, n)
    centred = (sample - sample.mean()) / sd
    cut = int(0.5 / math.sqrt(n - 4) * n)
    middle = float(np.sort(centred)[cut : n - cut].mean())
    kurtosis = n * float(((centred - middle) ** 4).sum()) / float((centred**2).sum()) ** 2
    if kurtosis > 0.5 * math.sqrt(n):
        return Interval(sd, 0.0, math.inf, level, n)
    z = float(ndtri(0.5 + 0.5 * level))
    small = n / (n - z)
    error = z * small * math.sqrt(max(kurtosis - (n - 3) / n, 1.0 / n) / (n - 1))
    centre = sd * math.sqrt(small)
    return Interval(sd, centre * math.exp(-0.5 * error), centre * math.exp(0.5 * error), level, n)


def _sample(values: npt.ArrayLike, level: float) -> FloatArray:
    if not 0 < level < 1:
        raise FieldError("level", f"{level!r} is not between 0 and 1")
    sample = np.asarray(values, dtype=float)
    if sample.ndim != 1 or not np.isfinite(sample).all():
        raise FieldError("values", "expected finite numbers (leave out or count the runs that have none)")
    return sample


class StopRule(Struct, frozen=True, kw_only=True):
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
        check_above_zero(half_width=self.half_width)
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


Decision = Literal["at least p1", "at most p0"]


class SequentialTest(Struct, frozen=True, kw_only=True):
    """A sequential test of p <= p_0 against p >= p_1.

    It is Wald's: it looks after every run, and stops as soon as its two errors allow.

    After n runs with s successes the logarithm of the likelihood ratio of p_1 against p_0 < p_1 is

        L = s log(p_1 / p_0) + (n - s) log((1 - p_1) / (1 - p_0)).

    It is a martingale's logarithm under p_0, and its negative under p_1, so that by Ville's inequality the bounds
    L >= log(1 / alpha) and L <= log(beta) are crossed wrongly with at most alpha and beta, whenever one looks. For p < p_0
    and p > p_1 the errors are smaller still. (Wald's own bounds, log((1 - beta) / alpha), hold only nearly.)

    Reference: A. Wald, Sequential Analysis, 1947, chapter 3.

    Args:
        p0: the probability that is too low.
        p1: the probability that is high enough, above ``p0``.
        alpha: largest probability to decide "at least p1" when p <= p_0.
        beta: largest probability to decide "at most p0" when p >= p_1.

    Raises:
        ValueError: unless 0 < p0 < p1 < 1 and both errors lie between 0 and 1; the message starts with the field.

    >>> test = SequentialTest(p0=0.95, p1=0.975, alpha=1e-3, beta=1e-3)
    >>> test.decide(265, 265), test.decide(266, 266), test.decide(266, 300)
    (None, 'at least p1', 'at most p0')
    >>> test.fewest
    266
    """

    p0: float
    p1: float
    alpha: float
    beta: float

    def __post_init__(self) -> None:
        if not 0.0 < self.p0 < self.p1 < 1.0:
            raise FieldError("p0", f"{self.p0:g}, p1: {self.p1:g}; expected 0 < p0 < p1 < 1")
        for name, value in (("alpha", self.alpha), ("beta", self.beta)):
            if not 0.0 < value < 1.0:
                raise FieldError(name, f"{value:g}; expected a number between 0 and 1")

    @property
    def fewest(self) -> int:
        """Number of runs in which the condition must hold, all of them, before "at least p1" can be decided."""
        n = max(math.ceil(-math.log(self.alpha) / math.log(self.p1 / self.p0)) - 1, 1)
        return next(runs for runs in range(n, n + 3) if self.decide(runs, runs) == "at least p1")

    def decide(self, successes: int, runs: int) -> Decision | None:
        """Return what is decided after some runs, None if more are needed."""
        ratio = successes * math.log(self.p1 / self.p0) + (runs - successes) * math.log((1.0 - self.p1) / (1.0 - self.p0))
        if ratio >= -math.log(self.alpha):
            return "at least p1"
        return "at most p0" if ratio <= math.log(self.beta) else None
