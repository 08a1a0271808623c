"""The ages under a packet law as a Markov chain in closed form, where latencies are bounded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from transport.draws import SLOT_TOLERANCE
from transport.errors import NotKnown
from transport.laws.latency import Latency, LatencyTrace, QuantileTable

if TYPE_CHECKING:
    from transport.laws.packet import PacketLaw

MOST_STATES = 512

State = tuple[int, tuple[int, ...]]
"""Age, and the modes of the channel for the last packets, newest first."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PacketChain:
    """The chain of the age of the newest packet under a packet law: a `ChainLaw` that says where it begins.

    Args:
        matrix: (N, N), Pr(state j in the next slot | state i).
        mode_ages: age of every state, (N,), slots. The largest age means: as old, or older.
        first: law of the state in slot 0, (N,); an age above 0 then means that nothing has come yet.
        bound: longest latency J, slots.
        neglected: probability that a packet's latency is beyond what the emulator draws, and so beyond `bound`; 0: exact.
    """

    matrix: NDArray[np.float64]
    mode_ages: tuple[int, ...]
    first: NDArray[np.float64]
    bound: int
    neglected: float = 0.0
    initial: Literal["given"] = "given"
    kind: str = "packet"

    def transition_matrix(self) -> NDArray[np.float64]:
        """Return the transition matrix, (N, N)."""
        return self.matrix

    def initial_law(self) -> NDArray[np.float64]:
        """Return the law of the state in slot 0, (N,)."""
        return self.first


def arrival_ages(
    latencies: QuantileTable, duplication: float, discard_older: int | None, period_s: float, deadline_s: float
) -> NDArray[np.float64]:  # fmt: skip
    """Return Pr(a packet that the channel does not lose comes first at age i), (J + 1,); what misses to 1 never comes.

    Args:
        latencies: of the packets.
        duplication: probability of a copy.
        discard_older: what the receiver discards, see `transport.laws.packet.PacketLaw`.
        period_s, deadline_s: length of a slot, and when it closes, s.
    """
    _, bound = _reach(latencies, discard_older, period_s, deadline_s)
    due = deadline_s + (np.arange(bound + 1, dtype=np.float64) + SLOT_TOLERANCE) * period_s
    late = 1.0 - latencies.cdf(np.asarray(due, dtype=np.float64))
    missed = (1.0 - duplication) * late + duplication * late**2
    return np.maximum(-np.diff(missed, prepend=1.0), 0.0)


def first_arrivals(law: PacketLaw, latencies: Latency, period_s: float, deadline_s: float) -> NDArray[np.float64]:
    """Return what `arrival_ages` says of a law whose packets come independently of each other, or wait.

    Args:
        law: the packet law.
        latencies, period_s, deadline_s: see `packet_chain`.

    Raises:
        NotKnown: they do neither, or have no bound that can be computed with.
    """
    if isinstance(latencies, LatencyTrace):
        raise NotKnown("its latencies are a recorded trace")
    if not law.reordering and law.duplication > 0.0:
        raise NotKnown("packets wait for the copies of those before them (reordering = false, duplication > 0)")
    longest, bound = _reach(latencies, law.discard_older, period_s, deadline_s)
    if bound > MOST_STATES:
        raise NotKnown(f"latencies reach {bound} slots, at most {MOST_STATES}{_bounds(law, longest)}")
    if (bound + 1) * (1 + (law.duplication > 0.0)) > law.queue:
        raise NotKnown(f"its queue of {law.queue} may be full, as latencies reach {bound} slots")
    return arrival_ages(latencies, law.duplication, law.discard_older, period_s, deadline_s)


def _reach(latencies: QuantileTable, discard_older: int | None, period_s: float, deadline_s: float) -> tuple[int, int]:
    """Slots that the longest latency takes, and those after which no packet comes any more."""
    longest = slots_late(latencies.values_s[-1], period_s, deadline_s)
    return longest, longest if discard_older is None else min(longest, discard_older)


def _bounds(law: PacketLaw, longest: int) -> str:
    return "" if law.discard_older is not None and law.discard_older < longest else "; discard_older = J bounds it"


def packet_chain(law: PacketLaw, latencies: Latency, period_s: float, deadline_s: float, reach: int = 0) -> PacketChain:
    """Return the chain of the ages.

    A packet is of age i in slot k when it was sent in slot k - i. Given that the newest packet that has come is of age a, none of
    the a packets behind it has come. Latencies are independent: each of these comes in the next slot with a probability of its
    own,

        h_i = Pr(it comes at age i | it has not come before),    i = 1 ... a,    and h_0 for the packet of that slot,

    whatever was before. The newest that comes decides: the next age is j with (1 - h_0) ... (1 - h_{j-1}) h_j, else a + 1. Beyond
    the longest latency J no h_i is left, and all larger ages follow one row: one state "older" stands for them, exactly.

    * Loss: a lost packet comes at no age. A Gilbert-Elliott channel: losses are independent given the modes of the channel, so
      that the state holds these for the last min(a, J) packets too.
    * A copy: what counts is the earlier of the two, as long as packets may overtake.
    * First in, first out, without copies: the packets behind the first that is not lost wait for it, so that nothing is known of
      their latencies. Which one is the first, the age (and the channel's modes) say as well as all history does.

    Before slot 0 a packet of slot -1 that says nothing stands for what has not come.

    Args:
        law: the packet law.
        latencies: its latencies.
        period_s, deadline_s: length of a slot, and when it closes, s.
        reach: ages up to this one are distinguished, whatever the longest latency.

    Raises:
        NotKnown: there is none.
    """
    if isinstance(latencies, LatencyTrace):
        raise NotKnown("its latencies are a recorded trace")
    longest, bound = _reach(latencies, law.discard_older, period_s, deadline_s)
    modes = len(law.channel_losses())
    windows = modes ** min(bound, 20)
    states = max(bound, reach) + 2 if modes == 1 else (3 + max(0, reach - bound)) * windows
    if states > MOST_STATES:
        said = f"latencies reach {bound} slots, so that its chain has {states} states, at most {MOST_STATES}"
        raise NotKnown(said + _bounds(law, longest))
    arrives = first_arrivals(law, latencies, period_s, deadline_s)
    cut = latencies.cut if law.discard_older is None or law.discard_older >= longest else 0.0
    return _explored(law, arrives, max(bound, reach) + 1, bound, cut)


def slots_late(latency_s: float, period_s: float, deadline_s: float) -> int:
    """Return after how many slots a packet with this latency comes: the smallest j >= 0 with L <= deadline + j T."""
    return max(0, math.ceil(min((latency_s - deadline_s) / period_s - SLOT_TOLERANCE, 2.0**53)))  # a quotient may be infinite


def _explored(law: PacketLaw, arrives: NDArray[np.float64], oldest: int, bound: int, cut: float) -> PacketChain:
    """Chain over the states that come up from slot 0 on."""
    losses, channel = list(law.channel_losses()), law.transition_matrix()
    ages = _waiting if not law.reordering else _overtaking
    comes = arrives.tolist()
    missed = np.maximum(1.0 - np.cumsum(arrives), 0.0)
    missed[missed < 1e-15] = 0.0
    late = missed.tolist()

    def following(state: State) -> dict[State, float]:
        age, known = state
        found: dict[State, float] = {}
        pending = min(age, bound)
        for mode, share in enumerate(channel[known[0]].tolist()):
            window = (mode, *known)
            lost = [losses[c] for c in window[: pending + 1]]
            for comes_at, probability in enumerate(ages(lost, comes, late)):
                now = comes_at if comes_at <= pending else min(age + 1, oldest)
                if share * probability > 0.0:
                    to = now, window[: max(1, min(now, bound))]
                    found[to] = found.get(to, 0.0) + share * probability
        return found

    first: dict[State, float] = {}
    for mode, share in enumerate(law.stationary().tolist()):
        for to, probability in following((0, (mode,))).items() if share > 0.0 else ():
            first[to] = first.get(to, 0.0) + share * probability
    rows: dict[State, dict[State, float]] = {}
    ahead = list(first)
    while ahead:
        state = ahead.pop()
        if state not in rows:
            rows[state] = following(state)
            ahead += rows[state]
    order = sorted(rows)
    index = {state: i for i, state in enumerate(order)}
    matrix, begin = np.zeros((len(order), len(order))), np.zeros(len(order))
    for state, row in rows.items():
        for to, probability in row.items():
            matrix[index[state], index[to]] = probability
    for to, probability in first.items():
        begin[index[to]] = probability
    matrix /= matrix.sum(axis=1, keepdims=True)
    return PacketChain(
        matrix=matrix, mode_ages=tuple(age for age, _ in order), first=begin / begin.sum(), bound=bound, neglected=cut
    )  # fmt: skip


def _overtaking(lost: Sequence[float], comes: Sequence[float], late: Sequence[float]) -> list[float]:
    """Pr(the newest that comes is of age 0, 1, ..., none comes), given that none has come; packets may overtake.

    Args:
        lost: loss probability of the packets of age 0, 1, ... in this slot.
        comes, late: Pr(a packet that is not lost comes at age i), and that it has not come by age i.
    """
    found, none = [], 1.0
    for i, loss in enumerate(lost):
        before = 1.0 if i == 0 else loss + (1.0 - loss) * late[i - 1]
        h = min(1.0, (1.0 - loss) * comes[i] / before) if before > 0.0 else 0.0
        found.append(none * h)
        none *= 1.0 - h
    return [*found, none]


def _waiting(lost: Sequence[float], comes: Sequence[float], late: Sequence[float]) -> list[float]:
    """Pr(none has come by the slot before) times the same, where packets wait for those before them, first in, first out."""
    oldest = len(lost) - 1

    def stays(ages: range) -> float:
        """Pr(none of the packets of these ages, oldest first, has come by this slot), given that no older one holds them up."""
        through, total = 1.0, 0.0
        for i in ages:
            total += through * (1.0 - lost[i]) * late[i]
            through *= lost[i]
        return total + through

    found = []
    for j in range(oldest + 1):
        comes_j = 0.0
        for b in range(oldest, j - 1, -1):  # the first that is not lost
            leads = prod(lost[b + 1 :]) * (1.0 - lost[b]) * comes[b]
            if b > j:
                leads *= (1.0 - lost[j]) * (1.0 - late[j])
                leads *= prod(lost[i] + (1.0 - lost[i]) * (1.0 - late[i]) for i in range(j + 1, b))
            comes_j += leads
        found.append(comes_j * stays(range(j - 1, -1, -1)))
    return [*found, stays(range(oldest, -1, -1))]
