"""Network laws judged: does a run's record agree with its law? Counts of modes and transitions, and p-values of chi-square tests.

Every test is conditional on the past: at each slot the law says with which probability each mode follows, so that
neither the length of the run nor a sojourn cut off by its end biases anything. Cells in which too little is expected
are pooled.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import erfc, exp, fsum, lgamma, log, sqrt
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from transport.draws import COPIED, LOST, OVERFLOW, SENT, SLOT_TOLERANCE
from transport.laws import ChannelLaw, MarkovModes, NetworkLaw, RecordedLaw, SemiMarkovLaw, slots_served

EXPECTED = 5.0
TAIL = 1e-3
"""p-value of Pearson's statistic below which that of the likelihood ratio counts too: what is expected 5 times comes 16 times or
more in 7 of 10^5 records, of which Pearson's says 1 in 10^6."""
LATENCY_BINS = 10
_BLOCK = 1 << 18  # transitions that are counted at once

Modes = NDArray[np.int64]
Records = Iterable[NDArray[np.void]]
"""Structured arrays, one after the other, with the fields of `transport.draws.Draw` that a test asks for."""


class Evidence(NamedTuple):
    """Pearson's statistic and that of the likelihood ratio, chi-square both, with their degrees of freedom.

    `possible` is False when something of probability 0 was seen; `scarce` is True when chance decides, but too seldom to test.
    """

    statistic: float
    ratio: float
    freedom: int
    possible: bool = True
    scarce: bool = False


def transition_counts(modes: Modes, size: int) -> NDArray[np.int64]:
    """Return how often mode j followed mode i, (size, size).

    >>> transition_counts(np.array([0, 1, 1, 0]), 2).tolist()
    [[0, 1], [1, 1]]
    """
    pairs = np.zeros(size * size, dtype=np.int64)
    for start in range(0, len(modes) - 1, _BLOCK):
        block = modes[start : start + _BLOCK + 1]
        pairs += np.bincount(block[:-1] * size + block[1:], minlength=size * size)
    return pairs.reshape(size, size)


def law_p_value(law: NetworkLaw, modes: Modes, draws: Records | None = None, slot: tuple[float, float] | None = None) -> float:
    """Return the p-value of a record under its law: uniform on [0, 1] if the law is right, up to the chi-square approximation.

    Below `TAIL` it is the larger of two, so that it is seldom smaller than it should be where little is expected.

    Chains are tested by the rows of their transition counts; semi-Markov laws by the hazard of leaving a
    mode at every sojourn time, and by the embedded chain; a record agrees (1.0) or does not (0.0); packet
    laws by their channel's transitions, and with `draws` by losses and latencies too. A user's law is tested by the
    protocol that it fulfils. NaN where there is no test (see `is_testable`), or too little was drawn for one.

    Args:
        law: parameters of the law.
        modes: mode of every slot from slot 0, (slots,).
        draws: packet laws only: the records of the whole run from slot 0, with the fields `slot`, `mode`, `latency_s` and
            `reason`; one of the arrays is in memory at a time.
        slot: its length and when it closes, s; of a packet law that discards old packets losses and latencies are tested only
            with it.
    """
    found = list(_evidence(law, modes, draws, slot))
    if not found:
        return float("nan")
    if not all(evidence.possible for evidence in found):
        return 0.0
    freedom = sum(evidence.freedom for evidence in found)
    if freedom == 0:  # nothing was left to chance, or too little to judge by
        return float("nan") if any(evidence.scarce for evidence in found) else 1.0
    p_value = chi_square_tail(sum(evidence.statistic for evidence in found), freedom)
    if p_value >= TAIL:
        return p_value
    return max(p_value, chi_square_tail(max(0.0, sum(evidence.ratio for evidence in found)), freedom))


def chi_square_tail(statistic: float, freedom: int) -> float:
    """Return the probability that a chi-square variable of `freedom` >= 1 degrees of freedom is larger than `statistic` >= 0.

    Q(k/2, x) with x = statistic / 2: Q(a + 1, x) = Q(a, x) + x^a exp(-x) / Gamma(a + 1), Q(0, x) = 0, Q(1/2, x) = erfc sqrt(x).
    Importing scipy.special for it takes a quarter of the time of `hil report`.

    >>> round(chi_square_tail(3.841459, 1), 6)
    0.05

    Reference: NIST Digital Library of Mathematical Functions, 8.8.2 and 8.4.6.
    """
    x = statistic / 2.0
    if x == 0.0:
        return 1.0
    odd = freedom % 2 / 2.0
    terms = (exp((odd + n) * log(x) - x - lgamma(odd + n + 1.0)) for n in range(freedom // 2))
    return min((erfc(sqrt(x)) if odd else 0.0) + fsum(terms), 1.0)


def is_testable(law: NetworkLaw) -> bool:
    """Return whether a record that is long enough can be tested against the law."""
    return isinstance(law, RecordedLaw | SemiMarkovLaw | MarkovModes)


def _evidence(law: NetworkLaw, modes: Modes, draws: Records | None, slot: tuple[float, float] | None) -> Iterator[Evidence]:
    if isinstance(law, RecordedLaw):
        ages, served = law.recorded(), slots_served(law)
        enough = served is None or len(modes) <= served
        yield Evidence(0.0, 0.0, 0, enough and bool((modes == np.resize(ages, len(modes))).all()))
    elif isinstance(law, SemiMarkovLaw):
        yield from _sojourn_evidence(law, modes)
    elif isinstance(law, MarkovModes):
        matrix = np.asarray(law.transition_matrix(), dtype=np.float64)
        if modes.max(initial=0) >= len(matrix):
            yield Evidence(0.0, 0.0, 0, False)
            return
        yield from _row_evidence(transition_counts(modes, len(matrix)), matrix)
        if isinstance(law, ChannelLaw) and draws is not None and (law.discard_older is None or slot is not None):
            yield from _packet_evidence(law, draws, slot)


def _row_evidence(counts: NDArray[np.int64], matrix: NDArray[np.float64]) -> Iterator[Evidence]:
    for observed, row in zip(counts, matrix, strict=True):
        yield _cells_evidence(observed, row)


def _cells_evidence(observed: NDArray[np.int64], probabilities: NDArray[np.float64]) -> Evidence:
    """Pearson's statistic of one multinomial, cells of small expectation pooled with the next larger ones."""
    expected = observed.sum() * probabilities
    possible = not observed[probabilities == 0.0].any()
    pools: list[list[float]] = []
    for i in np.argsort(expected, kind="stable"):
        if expected[i] == 0.0:
            continue
        if pools and pools[-1][1] < EXPECTED:
            pools[-1][0] += observed[i]
            pools[-1][1] += expected[i]
        else:
            pools.append([observed[i], expected[i]])
    if len(pools) < 2:
        return Evidence(0.0, 0.0, 0, possible, scarce=int(np.count_nonzero(probabilities)) > 1)
    pearson, ratio = sum((o - e) ** 2 / e for o, e in pools), sum(_ratio(o, e) for o, e in pools)
    return Evidence(float(pearson), ratio, len(pools) - 1, possible)


def _ratio(observed: float, expected: float) -> float:
    """What a cell adds to twice the logarithm of the likelihood ratio."""
    return 2.0 * float(observed) * log(observed / expected) if observed > 0.0 else 0.0


def _sojourn_evidence(law: SemiMarkovLaw, modes: Modes) -> Iterator[Evidence]:
    from transport.laws.sojourn import hazards

    size = len(law.matrix)
    if modes.max(initial=0) >= size:
        yield Evidence(0.0, 0.0, 0, False)
        return
    starts = np.flatnonzero(np.diff(modes)) + 1
    lengths = np.diff(np.append(starts, len(modes)))
    complete = np.arange(len(starts)) < len(starts) - 1  # the first sojourn has no known start, the last no known end
    jumps = transition_counts(np.concatenate([modes[:1], modes[starts]]), size)
    yield from _row_evidence(jumps, np.array(law.matrix))
    for i, sojourn in enumerate(law.sojourn):
        here = modes[starts] == i
        if not here.any():
            yield Evidence(0.0, 0.0, 0, scarce=True)
            continue
        longest = int(lengths[here].max())
        left = np.bincount(lengths[here & complete], minlength=longest + 1)[1:]
        cut = np.bincount(lengths[here & ~complete], minlength=longest + 1)[1:]
        # A sojourn of length n is at risk of ending in its slots 1..n; one cut off by the end of the run in 1..n-1.
        at_risk = (left + cut)[::-1].cumsum()[::-1] - cut
        yield from _hazard_evidence(left, at_risk, hazards(sojourn, longest))


def _hazard_evidence(left: NDArray[np.int64], at_risk: NDArray[np.int64], hazard: NDArray[np.float64]) -> Iterator[Evidence]:
    """One squared standard score per bin of sojourn times; the scores of a martingale are uncorrelated."""
    possible = not (left[hazard == 0.0].any() or (at_risk - left)[hazard == 1.0].any())
    expected = at_risk * hazard
    counted = np.stack([expected * (1.0 - hazard), expected, left, at_risk], axis=1)
    bins: list[NDArray[np.float64]] = []  # spread, expected, left, at risk
    for each in counted:
        if bins and bins[-1][0] < EXPECTED:
            bins[-1] = bins[-1] + each
        else:
            bins.append(each)
    if len(bins) > 1 and bins[-1][0] < EXPECTED:
        last = bins.pop()
        bins[-1] = bins[-1] + last
    usable = [each.tolist() for each in bins if each[0] >= EXPECTED]
    chance = bool(((hazard > 0.0) & (hazard < 1.0)).any())
    pearson = sum((gone - due) ** 2 / spread for spread, due, gone, _ in usable)
    ratio = sum(_ratio(gone, due) + _ratio(risk - gone, risk - due) for _, due, gone, risk in usable)
    yield Evidence(float(pearson), ratio, len(usable), possible, scarce=chance and not usable)


class _Packets(Struct):
    """What became of the packets of a channel, counted block by block.

    Args:
        fates: by mode: lost, sent; without packets that a recorded latency loses.
        binned: packets that were sent, by latency.
        sent, copied: packets.
        overflow: whether a queue was full.
        possible: whether every latency is one that the law can give.
    """

    fates: NDArray[np.int64]
    binned: NDArray[np.int64]
    sent: int = 0
    copied: int = 0
    overflow: bool = False
    possible: bool = True


def _packet_evidence(law: ChannelLaw, draws: Records, slot: tuple[float, float] | None) -> Iterator[Evidence]:
    """What is discarded is booked as lost: losses are more by the latencies beyond, and latencies are those within."""
    from transport.laws.latency import LatencyTrace, latency  # loaded where packets have latencies

    recorded, losses = latency(law.latency), law.channel_losses()
    latest = np.inf
    if law.discard_older is not None and slot is not None:
        latest = slot[1] + (law.discard_older + SLOT_TOLERANCE) * slot[0]
    kept = float(recorded.cdf(np.array([latest]))[0]) if np.isfinite(latest) else 1.0
    if isinstance(recorded, LatencyTrace):
        edges, reached = np.empty(0), np.array([0.0, 1.0])
        trace = np.asarray(recorded.values_s, dtype=np.float64)
    else:
        quantile, trace = recorded.sampler(), np.empty(0)
        edges = np.unique([quantile(level / LATENCY_BINS) for level in range(1, LATENCY_BINS)])
        edges = edges[edges < latest]
        reached = np.concatenate([[0.0], recorded.cdf(edges) / max(kept, 1e-300), [1.0]])
    found = _Packets(fates=np.zeros((2, len(losses)), np.int64), binned=np.zeros(len(edges) + 1, np.int64))
    for table in map(_columns, draws):
        fate = (table["mode"] >= 0) & np.isin(table["reason"], (SENT, LOST))
        sent = fate & (table["reason"] == SENT)
        observed = table["latency_s"][sent]
        found.sent += len(observed)
        found.copied += int((table["reason"] == COPIED).sum())
        found.overflow |= bool((table["reason"] == OVERFLOW).any())
        if isinstance(recorded, LatencyTrace):
            due = trace[table["slot"] % len(trace)]
            found.possible &= bool((observed == due[sent]).all() and not sent[np.isinf(due)].any())
            fate &= np.isfinite(due) & (due <= latest)  # the others are lost by the trace, whatever the channel does
        else:
            found.possible &= bool(((observed >= recorded.values_s[0]) & (observed <= recorded.values_s[-1])).all())
            found.binned += np.bincount(np.searchsorted(edges, observed), minlength=len(edges) + 1)
        fate &= table["mode"] < len(losses)
        for row, chosen in zip(found.fates, (fate & ~sent, fate & sent), strict=True):
            row += np.bincount(table["mode"][chosen], minlength=len(losses))
    yield Evidence(0.0, 0.0, 0, found.possible)
    chance = kept if not isinstance(recorded, LatencyTrace) else 1.0
    for (gone, came), loss in zip(found.fates.T, losses, strict=True):
        yield _cells_evidence(np.array([gone, came]), np.array([1.0 - (1.0 - loss) * chance, (1.0 - loss) * chance]))
    if not found.overflow and law.discard_older is None:  # of a copy that is discarded nothing is booked
        row = np.array([law.duplication, 1.0 - law.duplication])
        yield _cells_evidence(np.array([found.copied, found.sent - found.copied]), row)
    if not isinstance(recorded, LatencyTrace):
        yield _cells_evidence(found.binned, np.diff(reached))


def _columns(draws: NDArray[np.void]) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {name: draws[name].astype(np.int64) for name in ("slot", "mode", "reason")}
    return columns | {"latency_s": draws["latency_s"].astype(np.float64)}
