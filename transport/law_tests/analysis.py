"""What a network law does in the long run: shares of modes and ages, burst lengths, losses; before anything has run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, cast

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from transport.draws import DELIVERED, NO_MODE, OVERFLOW, SLOT_TOLERANCE
from transport.laws import ChainLaw, ChannelLaw, NetworkLaw, RecordedLaw, prepare, slots_served
from transport.laws.delay_states import delay_states, long_run, measured_ages
from transport.laws.latency import LatencyTrace, QuantileTable, latency
from transport.laws.packet_chain import arrival_ages, slots_late
from transport.laws.stochastic_matrix import stationary_row
from transport.medium.independent import impair

SIMULATED_SLOTS = 50_000
NEGLIGIBLE = 1e-12
LONGEST = 100_000


class LawAnalysis(Struct, frozen=True, kw_only=True):
    """A law in the long run.

    Attributes:
        kind: name of its plug-in.
        mode_ages: age of every mode in slots, (n,); empty for packet laws, whose modes are those of the channel.
        stationary: share of slots in every mode, (n,); empty for a law that does not say.
        mean_bursts: mean number of slots that a mode lasts, (n,).
        age_shares: share of slots in which the newest packet at the receiver is 0, 1, 2, ... slots old.
        mean_age: mean of that age, slots; infinite when nothing ever arrives, a lower bound when `older` is positive.
        older: share of slots in which the newest packet is older than any of `age_shares`.
        age_method: whether the ages are exact, or from a run of 50,000 slots with seed 0.
        loss_probability: share of packets that are lost, at the full queue too.
        overflow: share of packets that are lost at the full queue, from such a run; 0 where it cannot fill.
        unused: share of packets that are never the newest at the receiver, those that are lost included; NaN when not
            known.
        mean_latency_s: packet laws: mean latency, seconds; NaN for age laws.
    """

    kind: str
    mode_ages: tuple[int, ...]
    stationary: tuple[float, ...]
    mean_bursts: tuple[float, ...]
    age_shares: tuple[float, ...]
    mean_age: float
    older: float
    age_method: Literal["exact", "simulated"]
    loss_probability: float
    overflow: float
    unused: float
    mean_latency_s: float


def analyse_law(law: NetworkLaw, period_s: float, deadline_s: float, kind: str = "") -> LawAnalysis:
    """Return what a law does in the long run.

    Args:
        law: parameters of a network law; what it states by the protocols of `transport.laws` is
            exact, the rest comes from a run.
        period_s: length T of a slot, seconds.
        deadline_s: seconds after the start of a slot at which it closes.
        kind: name of its plug-in; that of its class by default.
    """
    law, kind = prepare(law), kind or type(law).__name__
    stationary, bursts = long_run(law) or (np.zeros(0), np.zeros(0))
    method: Literal["exact", "simulated"] = "exact"
    overflow = 0.0
    loss, mean_latency_s = 0.0, math.nan
    ages: Sequence[int] | None = None
    if isinstance(law, ChannelLaw):
        latencies = latency(law.latency)
        loss, mean_latency_s = law.loss_probability, latencies.mean_s
        if law.discard_older is not None and not isinstance(latencies, LatencyTrace):
            comes = arrival_ages(latencies, law.duplication, law.discard_older, period_s, deadline_s)
            loss = 1.0 - (1.0 - loss) * float(comes.sum())
        if law.reordering and not isinstance(latencies, LatencyTrace) and not _may_overflow(law, latencies, period_s, deadline_s):
            shares, unused = packet_age_shares(law, period_s, deadline_s), math.nan
        else:
            method = "simulated"
            shares, unused, overflow, gone = _simulated(law, period_s, deadline_s)
            if overflow and law.discard_older is not None:  # some at the full queue would be discarded, and copies are lost there
                loss = gone - overflow
    elif isinstance(law, RecordedLaw):
        recorded, ends = law.recorded(), slots_served(law) is not None
        ages = range(int(recorded.max()) + 1)
        cycle = measured_ages(recorded if ends else np.tile(recorded, 2))  # the second round knows what came before
        measured = cycle[-len(recorded) :]
        shares = np.bincount(measured) / len(measured)
        grown = np.diff(cycle[-len(recorded) - (not ends) :]) == 1
        unused = float(grown.mean()) if len(grown) else 0.0
    elif (states := delay_states(law)) is not None:
        ages = cast(ChainLaw, law).mode_ages
        weights = stationary_row(states.matrix)
        shares = np.bincount(states.ages, weights=weights).astype(np.float64)
        # a packet is passed over exactly when the measured age grows by one
        unused = float(weights @ (states.matrix * (states.ages[None, :] == states.ages[:, None] + 1)).sum(axis=1))
    else:
        method = "simulated"
        shares, unused, overflow, _ = _simulated(law, period_s, deadline_s)
    older = max(0.0, 1.0 - float(shares.sum())) if len(shares) == LONGEST else 0.0
    return LawAnalysis(
        kind=kind,
        mode_ages=() if ages is None else tuple(ages),
        stationary=tuple(stationary.tolist()),
        mean_bursts=tuple(bursts.tolist()),
        age_shares=tuple(shares.tolist()),
        mean_age=float(shares @ np.arange(len(shares))) + older * len(shares) if len(shares) else math.inf,
        older=older,
        age_method=method,
        loss_probability=float(loss) + overflow,
        overflow=overflow,
        unused=unused,
        mean_latency_s=mean_latency_s,
    )


def packet_age_shares(law: ChannelLaw, period_s: float, deadline_s: float) -> NDArray[np.float64]:
    """Return the stationary law of the age of the newest packet at the receiver, (ages,), under reordering.

    Packet k-b has not arrived at slot k with probability 1 - (1 - loss)(1 - s_b), where s_b = Pr(latency > deadline +
    b T), or its square for a packet with a copy. Given the channel's modes the packets are independent, so that the
    row vector v_b = Pr(newest is older than b - 1, mode of packet k-b) follows by products of diagonal and transition
    matrices; the channel is reversible, hence the same matrix backwards. Empty when nothing ever arrives.
    """
    latencies = latency(law.latency)
    if not latencies.lost and law.loss_probability < 1.0:
        losses, chain = np.array(law.channel_losses()), law.transition_matrix()
        older = stationary_row(chain)
        shares: list[float] = []
        while older.sum() > NEGLIGIBLE and len(shares) < LONGEST:
            age = len(shares) if law.discard_older is None else min(len(shares), law.discard_older)
            due = np.array([deadline_s + (age + SLOT_TOLERANCE) * period_s])
            late = 1.0 - float(latencies.cdf(due)[0])
            late = (1.0 - law.duplication) * late + law.duplication * late**2
            arrived = older * (1.0 - losses) * (1.0 - late)
            shares.append(float(arrived.sum()))
            older = (older - arrived) @ chain
        return np.array(shares)
    return np.zeros(0)


def _may_overflow(law: ChannelLaw, latencies: QuantileTable, period_s: float, deadline_s: float) -> bool:
    """Whether the queue can fill, in more than one slot of 10^12.

    A bounded latency bounds the packets in flight. Otherwise their number is a sum of independent ones of mean m <= (1 +
    duplication)(1 + mean latency / T), and Chernoff's bound says Pr(number >= q) <= exp(q - m - q log(q/m)), q > m.
    """
    if (slots_late(latencies.values_s[-1], period_s, deadline_s) + 1) * (1 + (law.duplication > 0.0)) <= law.queue:
        return False
    m, q = (1.0 + law.duplication) * (1.0 + latencies.mean_s / period_s), law.queue - 1
    return q <= m or q - m - q * math.log(q / m) > math.log(NEGLIGIBLE)


def _simulated(law: NetworkLaw, period_s: float, deadline_s: float) -> tuple[NDArray[np.float64], float, float, float]:
    """Of a run in which every slot sends: ages from the first arrival on, and the shares unused, overflown and never come."""
    network = impair(law, np.random.default_rng(0), period_s, deadline_s)
    slots = min(SIMULATED_SLOTS, slots_served(law) or SIMULATED_SLOTS)
    newest, ages, used, overflow, come = -1, [], 0, 0, set[int]()
    for k in range(slots):
        network.offer(k, None)
        draws, arrivals = network.collect(k)
        used += any(draw.reason == DELIVERED for draw in draws)
        overflow += any(draw.reason == OVERFLOW and draw.mode != NO_MODE for draw in draws)  # not of a copy
        come.update(g for g, _ in arrivals)
        newest = max([newest, *(g for g, _ in arrivals)])
        if newest >= 0:
            ages.append(k - newest)
    return np.bincount(ages) / max(len(ages), 1), 1.0 - used / slots, overflow / slots, 1.0 - len(come) / slots
