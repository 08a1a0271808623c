"""Everything that a record leaves possible for the chain of ages, with 95 % confidence: bounds of every transition.

Independent latencies and losses: a packet comes at age i, if it has not before, with probability h_i, whatever came before. Of
each h_i Clopper and Pearson's interval holds, together with probability 0.95 (Bonferroni); a row of the chain is made of products

    (1 - h_0) ... (1 - h_{j-1}) h_j,    j <= age,    and (1 - h_0) ... (1 - h_age) for one slot more,

which are monotone in every h_i. Of a Markov chain of ages the intervals are those of the counted transitions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from transport.law_fit import LawFit
from transport.law_fit.packet_record import delays_in_slots
from transport.law_fit.proportions import Interval, clopper_pearson, wilson

Array = NDArray[np.float64]

MISS = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AgeRegion:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrivals:
    """How many packets came at each age, of those that had not come before.

    Attributes:
        came, risk: for ages 0 ... J.
    """

    came: tuple[int, ...]
    risk: tuple[int, ...]

    def shares(self) -> list[tuple[float, Interval]]:
        """Return h_0 ... h_J, each with its own 95 % interval."""
        return [(c / n, wilson(c, n)) for c, n in zip(self.came, self.risk) if n]


def arrivals(fit: LawFit) -> Arrivals:
    """Count arrivals by age, for the slots of a fit."""
    delays = delays_in_slots(fit.record, fit.period_s, fit.deadline_s)
    came = np.bincount(delays[delays >= 0])
    risk = len(delays) - np.concatenate([[0], np.cumsum(came)[:-1]])
    return Arrivals(came=tuple(came.tolist()), risk=tuple(risk.tolist()))


def confidence_region(fit: LawFit, reach: int, factor: float = 1.0, share: float = 1.0) -> AgeRegion | str:
    """Return the region of the chain of ages, or in words why there is none.

    Args:
        fit: what was fitted.
        reach: ages up to this one are distinguished.
        factor: as if so many times the packets had been counted, in the same shares.
        share: of the 5 % that may miss.
    """
    if fit.law_class in ("constant", "independent"):
        if fit.record.until_s is not None and np.isfinite(fit.record.until_s).any():
            return "packets that were overtaken were not recorded"
        return _of_packets(fit, reach, factor, MISS * share)
    if fit.law_class == "markov":
        return _of_ages(fit, factor, MISS * share)
    if fit.law_class == "gilbert-elliott":
        return "losses come in bursts, and in which mode the channel was cannot be counted"
    if fit.law_class == "semi-markov":
        return "the tails of sojourn times cannot be counted"
    return "no class of law explains the record"


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
