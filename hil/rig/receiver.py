"""A network law seen by its receiver: the chain of the ages that it measures, and the samples that come slot by slot.

Beyond `max_age` the controller keeps the newest sample, and uses the gains of the largest delay; the actuator has no row, and
holds the last input.

A channel carries one node's samples to the controller. Its state is that of its law, such as the mode of a chain, and that of the
samples on their way. Under an age law a receiver measures an age a(k): the newest sample is the newest that was sent in or before
slot k - a(k). Under a packet law each packet has a delay of its own; the packets on their way, and when each comes, are part of
the state.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import Struct

from transport.errors import NotKnown
from transport.laws import AgeChain, NetworkLaw, PacketAges, PacketDelays, RecordedLaw, slots_served
from transport.laws.delay_states import DelayStates, delay_states, measured_ages

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


class Receiver(NamedTuple):
    """A receiver: when slots begin and close (s), the largest age that its rows or gains cover, and whether it holds an input."""

    period_s: float
    deadline_s: float
    max_age: int
    holds_input: bool


class Received(Struct, frozen=True, kw_only=True):
    """A network law as its receiver meets it.

    Args:
        path: of the law's table, for messages.
        law: the law.
        at: who receives.
        ages: the chain of the ages at the receiver under a packet law that has one, any other law as it is.
        states: the chain of the measured age, None where there is none; see `transport.laws.delay_states`.
        why_none: the reason why there is none, a phrase.
    """

    path: str
    law: NetworkLaw
    at: Receiver
    ages: NetworkLaw | AgeChain
    states: DelayStates | None
    why_none: str

    @property
    def of_packets(self) -> bool:
        """Whether it is a packet law with a chain of ages."""
        return isinstance(self.law, PacketAges) and isinstance(self.ages, AgeChain)

    def delays(self) -> DelayChain | None:
        """Return the delay chain of a packet law; None where the ages are no chain."""
        chain, at = self.ages, self.at
        if not isinstance(chain, AgeChain):
            return None
        from design.processes.delay_chain import DelayChain

        ages = np.array(chain.mode_ages, dtype=np.int64)
        oldest = at.max_age if at.holds_input else max(at.max_age, chain.bound)
        return DelayChain(
            transition=chain.transition_matrix(), delays=np.minimum(ages, oldest), labels=np.minimum(ages, at.max_age),
            held=ages > oldest,
        )  # fmt: skip

    def neglects(self) -> str:
        """Return what the chain neglects, a phrase; empty where it is exact."""
        chain = self.ages
        if not isinstance(chain, AgeChain) or not chain.neglected:
            return ""
        return (
            f"the latencies of {self.path} have no bound, and a packet is later than {chain.bound} slots with probability "
            f"{chain.neglected:.2g}, which is neglected; discard_older = {max(0, chain.bound - 1)} makes it exact"
        )

    def silent(self, slots: int = 0) -> float:
        """Return the probability that nothing has come in so many slots, nor while the chain distinguishes ages."""
        chain = self.ages
        if not isinstance(chain, AgeChain):
            return 0.0
        ages, weights = np.array(chain.mode_ages), chain.initial_law()
        last = max(chain.bound, self.at.max_age) + 1
        for k in range(max(last, slots)):  # nothing has come by slot k: of age k + 1 is what stands for it
            weights = np.where(ages >= min(k + 1, last), weights, 0.0) @ chain.transition_matrix()
        return float(weights[ages >= last].sum())


def received(path: str, law: NetworkLaw, at: Receiver, stays: int = 1) -> Received:
    """Return a network law as a receiver meets it.

    Args:
        path: of the law's table, for messages.
        law: the law, its files read.
        at: who receives.
        stays: lengths of stay at an age that the receiver distinguishes.
    """
    ages: NetworkLaw | AgeChain = law
    why = "it is a packet law or a trace"
    if isinstance(law, PacketAges):
        try:
            ages = law.age_chain(at.period_s, at.deadline_s, at.max_age)
        except NotKnown as reason:
            why = str(reason)
    return Received(path=path, law=law, at=at, ages=ages, states=delay_states(ages, stays), why_none=f"states no chain: {why}")


MOST_ENTRIES = 1024
"""Entries of a recording that are computed with: the theory takes one matrix per state, each on the stacked state."""

Chance = tuple[float, float, float]  # probability, its lower and its upper bound
SURE: Chance = (1.0, 1.0, 1.0)
OnWay = tuple[int, ...]
"""A node's samples on their way, in ages and slots."""


def recorded_cycle(law: RecordedLaw, *, drawn: bool = False) -> np.ndarray:
    """Return the ages that a receiver measures slot by slot once a recording repeats.

    Args:
        law: the recording.
        drawn: the ages of what comes instead, be it the newest or not.

    Raises:
        NotKnown: there is no such cycle, or it is too long.
    """
    if (slots := slots_served(law)) is not None:
        raise NotKnown(f"the recording ends after {slots} slots, and what follows is not known")
    ages = law.recorded()
    if len(ages) > MOST_ENTRIES:
        raise NotKnown(f"the recording has {len(ages)} entries, at most {MOST_ENTRIES} are computed with")
    return ages if drawn else measured_ages(np.tile(ages, 2 + int(ages.max()) // len(ages)))[-len(ages) :]


def recorded_chain(law: RecordedLaw) -> DelayChain:
    """Return the chain of ages that are recorded on the way to the actuator.

    Raises:
        NotKnown: there is none.
    """
    from design.processes.delay_chain import DelayChain

    try:
        cycle = recorded_cycle(law)
    except NotKnown as why:
        raise NotKnown(f"the law of network.ca states no chain: {why}") from None
    return DelayChain(transition=np.roll(np.eye(len(cycle)), 1, axis=1), delays=cycle, begins=np.arange(len(cycle)) == 0)


class AgeChannel(NamedTuple):
    """An age law or a recording. What is on its way: the ages of the newest sample sent in or before slot k, k - 1, ...

    In its methods `law_state` is the state of the law in this slot; `far` stands for a sample of this age or older, which is held
    or was never sent.

    Args:
        ages: the age that a receiver measures in every state.
        after: what follows each state.
        begins: states of the law in slot 0, each with its probability.
    """

    ages: tuple[int, ...]
    after: tuple[tuple[tuple[int, Chance], ...], ...]
    begins: tuple[tuple[int, float], ...]

    @property
    def oldest(self) -> int:
        """Largest delay, in slots, of a packet that is the newest when it comes."""
        return max(self.ages)

    @property
    def sure(self) -> bool:
        """Whether the newest sample that was sent is received in every slot, even if the node does not send in every slot."""
        return True

    def follows(self, law_state: int) -> tuple[tuple[int, Chance], ...]:
        """Return the states of the law that follow one."""
        return self.after[law_state]

    def sends(self, previous: OnWay | None, law_state: int, offered: int | None, far: int) -> Iterator[tuple[OnWay, Chance]]:
        """Yield what is on its way in a slot.

        Args:
            previous: in the slot before; None in slot 0.
            law_state: state of the law in this slot.
            offered: age of the sample that the node sends in this slot, None without one.
            far: as old, or older.
        """
        if previous is None:
            previous = (far,) * (self.oldest + 1)
        newest = previous[0] + 1 if offered is None else offered
        yield tuple(min(age, far) for age in (newest, *(age + 1 for age in previous[:-1]))), SURE

    def age(self, sent: OnWay, law_state: int) -> int:
        """Return the age of the newest sample that has come, at most `far`."""
        return sent[self.ages[law_state]]


class PacketChannel(NamedTuple):
    """A packet law with bounded delays.

    What is on its way: the age of the newest sample that has come, then of each packet that will come as the newest: in how many
    slots, and the age of its sample; the newest sample first.

    Args:
        comes: Pr(a packet that the channel does not lose comes j slots late), (J + 1,); what misses to 1 never comes.
        losses: loss probability in every mode of the law's channel.
        matrix: Pr(next mode | mode).
        in_order: whether a packet waits for those before it.
        begins: see `AgeChannel`.
    """

    comes: tuple[float, ...]
    losses: tuple[float, ...]
    matrix: tuple[tuple[float, ...], ...]
    in_order: bool
    begins: tuple[tuple[int, float], ...]

    @property
    def oldest(self) -> int:
        """See `AgeChannel.oldest`."""
        return len(self.comes) - 1

    @property
    def sure(self) -> bool:
        """See `AgeChannel.sure`."""
        return not any(self.losses) and max(self.comes) > 1.0 - 1e-15

    def follows(self, law_state: int) -> tuple[tuple[int, Chance], ...]:
        """See `AgeChannel.follows`."""
        return tuple((mode, (share,) * 3) for mode, share in enumerate(self.matrix[law_state]) if share > 0.0)

    def sends(self, previous: OnWay | None, law_state: int, offered: int | None, far: int) -> Iterator[tuple[OnWay, Chance]]:
        """See `AgeChannel.sends`."""
        newest, *flying = (far,) if previous is None else previous
        ahead = [(due - 1, age + 1) for due, age in zip(flying[::2], flying[1::2])]
        if offered is None:
            yield _arrived(newest + 1, ahead, far), SURE
            return
        last = max((due for due, _ in ahead), default=0) if self.in_order else 0
        gets = 1.0 - self.losses[law_state]
        outcomes: dict[OnWay, float] = {}
        for late, share in enumerate(self.comes):
            own = max(late, last)
            after = _arrived(newest + 1, [(own, offered), *(each for each in ahead if each[0] < own)], far)
            outcomes[after] = outcomes.get(after, 0.0) + gets * share
        lost = _arrived(newest + 1, ahead, far)
        outcomes[lost] = outcomes.get(lost, 0.0) + 1.0 - gets * sum(self.comes)
        yield from ((after, (share,) * 3) for after, share in outcomes.items() if share > 1e-15)

    def age(self, sent: OnWay, law_state: int) -> int:
        """See `AgeChannel.age`."""
        return sent[0]


Channel = AgeChannel | PacketChannel


def _arrived(newest: int, flying: list[tuple[int, int]], far: int) -> OnWay:
    """The state of a channel after the packets that are due now have come, newest sample first."""
    newest = min([newest, far, *(age for due, age in flying if due <= 0)])
    return (newest, *(number for due, age in flying if due > 0 and age < newest for number in (due, age)))


def channel_of(way: Received, *, drawn: bool = False) -> Channel:
    """Return the channel of a node's law to the controller.

    Args:
        way: the law as the controller meets it.
        drawn: for who takes older packets too: with the ages that an age law draws, in the place of those of the newest packet.

    Raises:
        NotKnown: what its states are.
    """
    law = way.law
    if isinstance(law, RecordedLaw):
        cycle = recorded_cycle(law, drawn=drawn)
        count = len(cycle)
        return AgeChannel(tuple(cycle.tolist()), tuple((((i + 1) % count, SURE),) for i in range(count)), ((0, 1.0),))
    if isinstance(law, PacketDelays):
        try:
            comes = law.delay_chances(way.at.period_s, way.at.deadline_s)
        except NotKnown as why:
            raise NotKnown(f"states no chain: {why}") from None
        return PacketChannel(
            comes=tuple(comes.tolist()), losses=tuple(law.channel_losses()),
            matrix=tuple(map(tuple, law.transition_matrix().tolist())), in_order=not law.reordering,
            begins=_begun(law.stationary()),
        )  # fmt: skip
    states = delay_states(way.ages, drawn=True) if drawn else way.states
    if way.of_packets:
        raise NotKnown("states the ages of packets sent in every slot, and not how late each of them comes (delay_chances)")
    if states is None:
        raise NotKnown(way.why_none)
    follows = tuple(
        tuple((j, (float(states.matrix[i, j]), float(states.low[i, j]), float(row[j]))) for j in np.flatnonzero(row).tolist())
        for i, row in enumerate(states.high)
    )  # fmt: skip
    return AgeChannel(tuple(states.ages.tolist()), follows, _begun(states.initial))


def _begun(initial: np.ndarray) -> tuple[tuple[int, float], ...]:
    return tuple((at, float(initial[at])) for at in np.flatnonzero(initial > 0.0).tolist())
