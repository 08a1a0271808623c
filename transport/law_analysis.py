"""What a network law does in the long run: shares of modes and ages, burst lengths, losses; before anything has run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from transport.draws import DELIVERED
from transport.impairment import impair
from transport.latency import LatencyTrace, latency
from transport.network_laws import prepare
from transport.packet_laws import SLOT_TOLERANCE, PacketLaw
from transport.semi_markov_law import SemiMarkovAge, augmented_chain
from transport.stochastic_matrix import stationary_row
from transport.trace_law import TraceAge

SIMULATED_SLOTS = 50_000
NEGLIGIBLE = 1e-12
LONGEST = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class LawAnalysis:
    """A law in the long run.

    Attributes:
        kind: kind of the law.
        mode_ages: age of every mode in slots, (n,); empty for packet laws, whose modes are those of the channel.
        stationary: share of slots in every mode, (n,); empty for a law that does not say.
        mean_bursts: mean number of slots that a mode lasts, (n,).
        age_shares: share of slots in which the newest packet at the receiver is 0, 1, 2, ... slots old.
        mean_age: mean of that age, slots; infinite when nothing ever arrives.
        age_method: whether the ages are exact, or from a run of 50,000 slots with seed 0.
        loss_probability: share of packets that the law loses.
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
    age_method: Literal["exact", "simulated"]
    loss_probability: float
    unused: float
    mean_latency_s: float


def analyse_law(law: Any, period_s: float, deadline_s: float) -> LawAnalysis:
    """Return what a law does in the long run.

    Args:
        law: parameters of a network law; the methods `stationary` and `mean_bursts` are used where it has them.
        period_s: length T of a slot, seconds.
        deadline_s: seconds after the start of a slot at which it closes.
    """
    law = prepare(law)
    stationary = law.stationary() if hasattr(law, "stationary") else np.zeros(0)
    method: Literal["exact", "simulated"] = "exact"
    if isinstance(law, PacketLaw):
        latencies = latency(law.latency)
        if law.reordering and not isinstance(latencies, LatencyTrace):
            shares, unused = packet_age_shares(law, period_s, deadline_s), math.nan
        else:
            method = "simulated"
            shares, unused = _simulated(law, period_s, deadline_s)
    elif hasattr(law, "stationary") and hasattr(law, "mode_ages"):
        shares = np.bincount(law.mode_ages, weights=stationary).astype(np.float64)
        unused = _unused(law)
    else:
        method = "simulated"
        shares, unused = _simulated(law, period_s, deadline_s)
    return LawAnalysis(
        kind=str(getattr(law, "kind", type(law).__name__)),
        mode_ages=() if isinstance(law, PacketLaw) else tuple(getattr(law, "mode_ages", ())),
        stationary=tuple(stationary.tolist()),
        mean_bursts=tuple(law.mean_bursts().tolist()) if hasattr(law, "mean_bursts") else (),
        age_shares=tuple(shares.tolist()),
        mean_age=float(shares @ np.arange(len(shares))) if len(shares) else math.inf,
        age_method=method,
        loss_probability=float(getattr(law, "loss_probability", 0.0)),
        unused=unused,
        mean_latency_s=latency(law.latency).mean_s if isinstance(law, PacketLaw) else math.nan,
    )


def packet_age_shares(law: PacketLaw, period_s: float, deadline_s: float) -> NDArray[np.float64]:
    """Return the stationary law of the age of the newest packet at the receiver, (ages,), under reordering.

    Packet k-b has not arrived at slot k with probability 1 - (1 - loss)(1 - s_b), where s_b = Pr(latency > deadline +
    b T), or its square for a packet with a copy. Given the channel's modes the packets are independent, so that the
    row vector v_b = Pr(newest is older than b - 1, mode of packet k-b) follows by products of diagonal and transition
    matrices; the channel is reversible, hence the same matrix backwards. Empty when nothing ever arrives.
    """
    latencies = latency(law.latency)
    if not latencies.lost and law.loss_probability < 1.0:
        losses, chain = np.array(law.channel_losses()), law.transition_matrix()
        older = law.stationary()
        shares: list[float] = []
        while older.sum() > NEGLIGIBLE and len(shares) < LONGEST:
            due = np.array([deadline_s + (len(shares) + SLOT_TOLERANCE) * period_s])
            late = 1.0 - float(latencies.cdf(due)[0])
            late = (1.0 - law.duplication) * late + law.duplication * late**2
            arrived = older * (1.0 - losses) * (1.0 - late)
            shares.append(float(arrived.sum()))
            older = (older - arrived) @ chain
        return np.array(shares)
    return np.zeros(0)


def _unused(law: Any) -> float:
    """A packet is passed over exactly when the age grows by one; with gaps it may still come back, so nothing is claimed."""
    if getattr(law, "allow_gaps", True):
        return math.nan
    if isinstance(law, TraceAge):
        ages = np.array(law.loaded().ages)
        steps = np.diff(np.append(ages, ages[0]) if law.past_end == "repeat" else ages)
        return float((steps == 1).mean()) if len(steps) else 0.0
    ages = np.array(law.mode_ages)
    if isinstance(law, SemiMarkovAge):
        chain = augmented_chain(law)
        matrix, ages = chain.matrix, ages[chain.modes]
    elif hasattr(law, "transition_matrix"):
        matrix = law.transition_matrix()
    else:
        return math.nan
    return float(stationary_row(matrix) @ (matrix * (ages[None, :] == ages[:, None] + 1)).sum(axis=1))


def _simulated(law: Any, period_s: float, deadline_s: float) -> tuple[NDArray[np.float64], float]:
    """Ages and unused share of a run in which every slot sends a packet; without the slots before the first arrival."""
    network = impair(law, np.random.default_rng(0), period_s, deadline_s)
    length: int | None = getattr(law, "length", None)
    slots = min(SIMULATED_SLOTS, length or SIMULATED_SLOTS)
    newest, ages, used = -1, [], 0
    for k in range(slots):
        network.offer(k, None)
        draws, arrivals = network.collect(k)
        used += any(draw.reason == DELIVERED for draw in draws)
        newest = max([newest, *(g for g, _ in arrivals)])
        if newest >= 0:
            ages.append(k - newest)
    return np.bincount(ages) / max(len(ages), 1), 1.0 - used / slots
