"""What counts and residuals prove of a law: intervals of counted probabilities, and whether a law explains a record.

And everything that a record leaves possible for the chain of ages, with 95 % confidence: bounds of every transition.

Independent latencies and losses: a packet comes at age i, if it has not before, with probability h_i, whatever came before. Of
each h_i Clopper and Pearson's interval holds, together with probability 0.95 (Bonferroni); a row of the chain is made of products

    (1 - h_0) ... (1 - h_{j-1}) h_j,    j <= age,    and (1 - h_0) ... (1 - h_age) for one slot more,

which are monotone in every h_i. Of a Markov chain of ages the intervals are those of the counted transitions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import Struct
from scipy import special

from transport.errors import NotKnown
from transport.law_fit.packet_record import Array, delays_in_slots

if TYPE_CHECKING:
    from transport.law_fit import LawFit


LEVEL = 0.95


class Interval(NamedTuple):
    """Both ends."""

    low: float
    high: float


def clopper_pearson(count: Array, n: Array, miss: float) -> tuple[Array, Array]:
    """Return intervals that hold with probability 1 - `miss` at least, each, whatever the probability (1934).

    Args:
        count: how often it was seen; need not be whole.
        n: of how many.
        miss: probability of an interval that does not hold.
    """
    low = np.where(count > 0, special.betaincinv(np.maximum(count, 1e-12), n - count + 1.0, miss / 2.0), 0.0)
    high = np.where(count < n, special.betaincinv(count + 1.0, np.maximum(n - count, 1e-12), 1.0 - miss / 2.0), 1.0)
    return np.asarray(low), np.asarray(high)


def interval_of(count: float, n: float) -> Interval:
    """Return Clopper and Pearson's 95 % interval of a probability, of which `count` in `n` were seen; all of [0, 1] for none.

    Wilson's (1927) is shorter, and holds in 84 % where one is seen of 300 and the probability is 0.0006.

    >>> [round(end, 4) for end in interval_of(10, 100)]
    [0.049, 0.1762]
    """
    low, high = clopper_pearson(np.array([count]), np.array([n]), 1.0 - LEVEL)
    return Interval(float(low[0]), float(high[0]))


LAGS = 20
"""Tested at most, see `lags_tested`."""
CELLS = 40
REJECT = 0.001
"""Probability with which a right law is rejected by a test, about: of 300 to 500 packets 1.7 in 1000."""
TESTS = 5
POWER = 0.9


def lags_tested(n: int) -> int:
    """Return up to which lag n residuals are tested: one in 50, as the statistic of many lags exceeds its limit too often.

    >>> lags_tested(300), lags_tested(5000)
    (6, 20)
    """
    return max(1, min(LAGS, n // 50))


class Fitness(NamedTuple):
    """Tests of one law on one record.

    Attributes:
        neighbours: p-value of independence of neighbours: the smallest of three, times three.
        lags: p-value of Ljung and Box's statistic over `lags_tested`, of residuals or of their size (the smaller, times two).
        independence: p-value of independence: the smallest of all five, times five.
        largest: the largest correlation of residuals at any of `LAGS` lags, in size.
        largest_lag: where it is.
        shape: p-value of the distribution of the residuals.
    """

    neighbours: float
    lags: float
    independence: float
    largest: float
    largest_lag: int
    shape: float

    @property
    def independent(self) -> bool:
        """Whether independence of the residuals is not rejected."""
        return self.independence > REJECT

    @property
    def shaped(self) -> bool:
        """Whether the residuals are distributed as the law says."""
        return self.shape > REJECT


def fitness(low: Array, high: Array, parameters: int, rng: np.random.Generator) -> Fitness:
    """Test residuals.

    They must be independent and normal.

    Every law says, of the next packet or slot and given the past, Pr(X < x) and Pr(X <= x). A uniform number between both of what
    came is uniform on [0, 1] and independent of all before, if the law is right (Rosenblatt 1952; randomised where there are
    atoms, Dunn and Smyth 1996); its normal quantile is the residual. That of |2 u - 1|, uniform and independent as well, is large
    where x is far from the middle, whichever side: it sees changes of spread, and bursts. Both are normal whatever the latencies
    are, so that no heavy tail spoils a test. Five tests, each at a fifth of the level (Bonferroni): of both kinds the correlation
    of neighbours, and the statistic of Ljung and Box (1978) over `lags_tested` lags; and the table of neighbours' thirds.

    Args:
        low, high: (n,) Pr(X < x) and Pr(X <= x) of what came, given the past.
        parameters: of the law, estimated from these data.
        rng: for the uniform numbers.
    """
    u = low + (high - low) * rng.random(len(low))
    score = _normal(u)
    counts = np.histogram(u, bins=np.linspace(0.0, 1.0, CELLS + 1))[0]
    chi_square = float(((counts - len(u) / CELLS) ** 2).sum() / (len(u) / CELLS))
    freedom = CELLS - 1 - min(parameters, CELLS // 2)
    plain, sizes, root_n = correlations(score), correlations(_normal(np.abs(2.0 * u - 1.0))), len(u) ** 0.5
    neighbours = min(_thirds(u), *(2.0 * float(special.ndtr(-abs(r[0]) * root_n)) for r in (plain, sizes)))
    lags = min(_ljung_box(r[: lags_tested(len(u))], len(u)) for r in (plain, sizes))
    largest = int(np.abs(plain).argmax())
    return Fitness(
        neighbours=min(1.0, 3.0 * neighbours), lags=min(1.0, 2.0 * lags), independence=min(1.0, TESTS * min(neighbours, lags)),
        largest=float(plain[largest]), largest_lag=largest + 1, shape=float(special.chdtrc(freedom, chi_square)),
    )  # fmt: skip


class Seen(NamedTuple):
    """Correlations of residuals that the tests of independence find in 9 of 10 records: of neighbours, and at one lag beyond."""

    neighbours: float
    apart: float


def seen_correlations(n: int) -> Seen:
    r"""Return the smallest correlations that are found with a power of 90 %; smaller ones are often missed.

    .. math:: r_1 = (z_{1 - \alpha/2} + z_{0.9}) / \sqrt n, \qquad \Pr(\chi^2_{m, n r_k^2} > \chi^2_{m, 1 - \alpha}) = 0.9

    with :math:`\alpha` a fifth of the level, and m = `lags_tested` lags.

    Args:
        n: residuals.

    >>> [round(each, 3) for n in (1000, 10_000) for each in seen_correlations(n)]
    [0.158, 0.222, 0.05, 0.07]
    """
    level, lags = REJECT / TESTS, lags_tested(n)
    limit = special.chdtri(lags, level)
    more = special.chndtrinc(limit, lags, 1.0 - POWER)
    return Seen(float((special.ndtri(POWER) - special.ndtri(level / 2.0)) / n**0.5), float((more / n) ** 0.5))


def behind_late(fit: LawFit) -> Interval:
    """Return the 95 % interval of the probability that behind a packet that is late or lost the next one is, too.

    Args:
        fit: with the slots in which packets count.
    """
    late = delays_in_slots(fit.record, fit.period_s, fit.deadline_s) != 0
    return interval_of((late[1:] & late[:-1]).sum(), late[:-1].sum())


def _normal(u: Array) -> Array:
    """Normal quantiles of uniform numbers; 0 and 1, where a table ends at the extremes of the record, count as half a packet."""
    half = 0.5 / len(u)
    return np.asarray(special.ndtri(np.clip(u, half, 1.0 - half)), dtype=np.float64)


def correlations(values: Array) -> Array:
    """Return the correlations of (n,) values at lags 1 ... `LAGS`; 0 of a constant."""
    v = values - values.mean()
    power = float(v @ v)
    return np.array([float(v[:-k] @ v[k:]) / power if power > 0.0 else 0.0 for k in range(1, LAGS + 1)])


def _ljung_box(r: Array, n: int) -> float:
    return float(special.chdtrc(len(r), n * (n + 2) * (r**2 / (n - np.arange(1, len(r) + 1))).sum()))


def _thirds(u: Array) -> float:
    """p-value of the 3 x 3 table of neighbours' thirds: chi-square with 4 degrees of freedom."""
    third = np.minimum((3.0 * u).astype(np.int64), 2)
    table = np.zeros((3, 3))
    np.add.at(table, (third[:-1], third[1:]), 1.0)
    expected = table.sum(axis=1, keepdims=True) * table.sum(axis=0, keepdims=True) / table.sum()
    if (expected <= 0.0).any():
        return 1.0
    return float(special.chdtrc(4, ((table - expected) ** 2 / expected).sum()))


MISS = 0.05


class AgeRegion(Struct, frozen=True, kw_only=True, eq=False):
    """A chain of ages, and bounds of its transition probabilities.

    Attributes:
        matrix, low, high: (N, N) what was seen, and both bounds.
        ages: (N,) of the states; the largest means: as old, or older, where `open_ended`.
        open_ended: whether older ones are possible.
        bound: age beyond which no packet is taken.
    """

    matrix: Array
    low: Array
    high: Array
    ages: tuple[int, ...]
    open_ended: bool
    bound: int


class Arrivals(Struct, frozen=True, kw_only=True):
    """How many packets came at each age, of those that had not come before.

    Attributes:
        came, risk: for ages 0 ... J.
        independent: whether what becomes of one packet says nothing of another: where losses come in bursts, what is counted
            spreads by several times as much as the intervals of independent packets say.
    """

    came: tuple[int, ...]
    risk: tuple[int, ...]
    independent: bool

    def shares(self) -> list[tuple[float, Interval | None]]:
        """Return h_0 ... h_J, each with its own 95 % interval; None where packets are not independent."""
        return [(c / n, interval_of(c, n) if self.independent else None) for c, n in zip(self.came, self.risk) if n]


def arrivals(fit: LawFit) -> Arrivals:
    """Count arrivals by age, for the slots of a fit."""
    delays = delays_in_slots(fit.record, fit.period_s, fit.deadline_s)
    came = np.bincount(delays[delays >= 0])
    risk = len(delays) - np.concatenate([[0], np.cumsum(came)[:-1]])
    return Arrivals(
        came=tuple(came.tolist()), risk=tuple(risk.tolist()), independent=fit.law_class in ("constant", "independent")
    )


def confidence_region(fit: LawFit, reach: int, factor: float = 1.0, share: float = 1.0) -> AgeRegion:
    """Return the region of the chain of ages.

    Args:
        fit: what was fitted.
        reach: ages up to this one are distinguished.
        factor: as if so many times the packets had been counted, in the same shares.
        share: of the 5 % that may miss.

    Raises:
        NotKnown: there is none.
    """
    if fit.law_class in ("constant", "independent"):
        if fit.record.until_s is not None and np.isfinite(fit.record.until_s).any():
            raise NotKnown("packets that were overtaken were not recorded")
        return _of_packets(fit, reach, factor, MISS * share)
    if fit.law_class == "markov":
        return _of_ages(fit, factor, MISS * share)
    if fit.law_class == "gilbert-elliott":
        raise NotKnown("losses come in bursts, and in which mode the channel was cannot be counted")
    if fit.law_class == "semi-markov":
        raise NotKnown("the tails of sojourn times cannot be counted")
    raise NotKnown("no class of law explains the record")


def _of_packets(fit: LawFit, reach: int, factor: float, miss: float) -> AgeRegion:
    counted = arrivals(fit)
    came, risk = (np.array(values, dtype=np.float64) * factor for values in (counted.came, counted.risk))
    low, high = clopper_pearson(came, risk, miss / len(came))
    bound = len(came) - 1
    oldest = max(bound, reach) + 1
    matrix, least, most = (_rows(h, missed, oldest) for h, missed in ((came / risk, came / risk), (low, high), (high, low)))
    return AgeRegion(
        matrix=matrix, low=np.minimum(least, matrix), high=np.maximum(most, matrix), ages=tuple(range(oldest + 1)),
        open_ended=True, bound=bound,
    )  # fmt: skip


def _rows(comes: Array, before: Array, oldest: int) -> Array:
    """Rows from h_i of what comes and of what has not: with `before` the other bound, these are bounds of every entry."""
    found = np.zeros((oldest + 1, oldest + 1))
    none = np.concatenate([[1.0], np.cumprod(1.0 - before)])
    for age in range(oldest + 1):
        seen = min(age, len(comes) - 1)
        found[age, : seen + 1] = none[: seen + 1] * comes[: seen + 1]
        found[age, min(age + 1, oldest)] += none[seen + 1]
    return found


def _of_ages(fit: LawFit, factor: float, miss: float) -> AgeRegion:
    assert fit.ages is not None
    counts = fit.ages.counts.astype(np.float64) * factor
    totals = np.broadcast_to(counts.sum(axis=1, keepdims=True), counts.shape)
    ages = np.asarray(fit.ages.ages)
    possible = (ages[None] <= ages[:, None] + 1) | (counts > 0)
    low, high = clopper_pearson(counts, totals, miss / max(1, int(possible.sum())))
    return AgeRegion(
        matrix=counts / totals, low=np.where(possible, low, 0.0), high=np.where(possible, high, 0.0), ages=tuple(ages.tolist()),
        open_ended=False, bound=int(ages.max()),
    )  # fmt: skip
