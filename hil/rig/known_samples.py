r"""The samples that a controller of historical data knows, as a Markov chain: nodes with clocks and turns, losses, late packets.

In slot k the controller keeps, of each node, the samples that came of the last tau slots, and the newest one of all, see
`hil.runtime.nodes.controller_input.SampleHistory`. Which samples these are is a part of the state, beside what is on its way;
all states that can be reached from slot 0 are enumerated as in `hil.rig.received_ages`. A gain on x_l(k - j) acts on the newest
sample of slot k - j or before that is known. A node of which nothing younger than W slots is known, older than any packet when it
comes, is held from its last sample, of any age, which is an entry h_l of the loop's state, taken as it becomes older:

.. math:: h_l(k+1) = x_l(k - W) \ \text{if a sample of the node is known in slot } k, \text{ else } h_l(k)

It counts once none is known any more, and the last one that was known was of slot k - W then. So finitely many phases are exact,
however many packets in a row get lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import HistoryGains, SensorNodes
from design.controllers.sensor_nodes import PacketWindow, Turns, phase_at, window_of
from design.historical_data import cycle
from design.historical_data.sensor_schedule import PhaseGains
from design.jump_linear.order_of_modes import led_to
from hil.rig import RigSpec
from hil.rig.received_ages import MOST_STATES, explored, media_and_channels, waiting
from hil.rig.receiver import AgeChannel, Chance, Channel, OnWay, PacketChannel, Received
from transport.errors import NotKnown

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain

class Kept(NamedTuple):
    """What is on its way of a node, the ages of its samples that are known as bits, and whether the newest packets came.

    The last is of as many slots as count, newest first; of the first slots of a run there are fewer.
    """

    on_way: tuple[int, ...]
    known: int
    came: tuple[bool, ...]


class KeepsSamples(NamedTuple):
    """A node's channel, with what the controller keeps of its samples; see `hil.rig.received_ages.FollowsPackets`.

    Args:
        channel: of the packets.
        memory: tau, the age of the oldest sample that is kept besides the newest one.
        reach: W, no packet is older when it comes for the first time.
        buffer: samples of a packet.
        outcomes: slots of which it counts whether their packet came; after ``late`` slots it has.
        late: slots that a packet takes, where outcomes count.
    """

    channel: Channel
    memory: int
    reach: int
    buffer: int
    outcomes: int
    late: int

    @property
    def begins(self) -> tuple[tuple[int, float], ...]:
        """States of the law in slot 0, each with its probability."""
        return self.channel.begins

    def follows(self, law_state: int) -> tuple[tuple[int, Chance], ...]:
        """Return the states of the law that follow one."""
        return self.channel.follows(law_state)

    def sends(self, previous: Kept | None, law_state: int, offered: int | None, far: int) -> Iterator[tuple[Kept, Chance]]:
        """Yield what is on its way and what is known in a slot."""
        before = Kept((), 0, ()) if previous is None else previous
        aged = before.known << 1
        for on_way, came, chance in self._arrived(before.on_way if previous else None, aged, law_state, offered, far):
            known = aged
            for age in came:
                known |= ((1 << self.buffer) - 1) << age
            known &= (2 << self.reach) - 1
            young = known & ((2 << self.memory) - 1)
            known = young or known & -known  # of what is too old the newest alone stays
            slots = min(len(before.came) + 1, self.outcomes + self.late)
            own = slots > self.late and bool(known >> self.late & 1)
            yield Kept(on_way, known, (own, *before.came)[: slots if self.outcomes else 0]), chance

    def _arrived(
        self, previous: OnWay | None, aged: int, law_state: int, offered: int | None, far: int
    ) -> Iterator[tuple[OnWay, tuple[int, ...], Chance]]:
        """Yield what is on its way, and the ages of the samples that come now."""
        channel = self.channel
        if isinstance(channel, AgeChannel):
            for sent, chance in channel.sends(previous, law_state, offered, far):
                age = channel.age(sent, law_state)
                yield sent, (age,) if age < far else (), chance
            return
        flying = () if previous is None else previous
        ahead = tuple((due - 1, age + 1) for due, age in zip(flying[::2], flying[1::2]))
        outcomes = {ahead: 1.0} if offered is None else self._outcomes(channel, ahead, law_state, offered)
        for packets, share in outcomes.items():
            came = tuple(age for due, age in packets if due <= 0)
            later = sorted(each for each in packets if each[0] > 0 and (channel.in_order or self._matters(*each, aged)))
            yield tuple(number for each in later for number in each), came, (share,) * 3

    @staticmethod
    def _outcomes(
        channel: PacketChannel, ahead: tuple[tuple[int, int], ...], law_state: int, offered: int
    ) -> dict[tuple[tuple[int, int], ...], float]:
        last = max((due for due, _ in ahead), default=0) if channel.in_order else 0
        gets = 1.0 - channel.losses[law_state]
        found = {ahead: 1.0 - gets * sum(channel.comes)}
        for late, share in enumerate(channel.comes):
            packets = (*ahead, (max(late, last), offered))
            found[packets] = found.get(packets, 0.0) + gets * share
        return {packets: share for packets, share in found.items() if share > 1e-15}

    def _matters(self, due: int, age: int, known: int) -> bool:
        """Whether a packet will bring a sample that is not known: young enough to be kept, or newer than all."""
        oldest = min(age + self.buffer - 1, self.memory - due)
        return not known or known & -known > 1 << age or any(not known >> sample & 1 for sample in range(age, oldest + 1))


class _Phases(Struct, frozen=True, kw_only=True):
    """Which gains act in a state, by what the controller counts: slots, the packet of this slot, or those of the last slots."""

    uses: str
    turns: Turns | None
    window: PacketWindow | None
    late: int

    @property
    def outcomes(self) -> int:
        """Slots of which it counts whether their packet came."""
        return 0 if self.uses == "history" else 1 if self.window is None else self.window.length

    def of(self, slot: int, sent: Sequence[Kept]) -> int | None:
        """Return the phase of the gains in a slot of the cycle; None without one."""
        turns, valid = self.turns, len(sent[0].came) - self.late
        if self.uses == "history" or turns is None:
            return phase_at(turns, slot)
        if valid <= 0:
            return None
        came = [next((n for n, kept in enumerate(sent) if kept.came[e]), None) for e in range(valid)]
        turn = (slot - self.late + turns.phase) % len(turns.order) if turns.order else 0
        if self.window is None:
            return came[0] if not turns.order else turn if came[0] == turns.order[turn] else None
        if turns.order:
            return turn + len(turns.order) * sum(1 << e for e, node in enumerate(came) if node is None)
        return self.window.phase(valid - 1, lambda sent: came[valid - 1 - sent])


def phases_over(
    rig: RigSpec, arriving: Sequence[Received], controller: HistoryGains, nodes: SensorNodes, *, in_phase: bool = True
) -> PhaseGains:
    """Return the gains that act on the plant's own past in every state of what is known, and the chain of these states.

    Args:
        rig: its laws' files read.
        arriving: the law of each sensor node, as the controller meets it.
        controller: gains over historical data.
        nodes: the sensor nodes, as the controller knows them.
        in_phase: as of `hil.rig.received_ages.received_ages`.

    Raises:
        NotKnown: there is no such chain.
        ValueError: gains that do not fit the nodes.
    """
    K = np.array(controller.history(), dtype=float)
    media, channels = media_and_channels(rig, arriving, bands="", drawn=True)
    counted = _Phases(
        uses=controller.uses, turns=nodes.turns, late=nodes.delays[0] or 0,
        window=window_of(nodes.turns, len(K)) if controller.uses == "last-packets" and nodes.turns is not None else None,
    )  # fmt: skip
    memory = K.shape[1] - 1
    far = []
    for n, (channel, wait) in enumerate(zip(channels, waiting(rig.sensors, media))):
        always = rig.sensors[n].clock.every == 1 and not any(n in medium.members for medium in media)
        slots = channel.oldest * (2 if isinstance(channel, AgeChannel) and not always else 1)
        far.append(slots + wait + 1)  # under an age law a sample that is older has come before, if it ever does
    reach = max(memory, *(each - 1 for each in far))
    keeps = [
        KeepsSamples(channel, memory, reach, sensor.buffer, counted.outcomes, counted.late)
        for channel, sensor in zip(channels, rig.sensors)
    ]
    turns = 1 if nodes.turns is None or not nodes.turns.cycle else nodes.turns.phases
    states, steps = explored(rig.sensors, media, keeps, far, in_phase=in_phase, cycle=turns)
    if any(low != high for _, _, (_, low, high) in steps):
        raise NotKnown("the tail of a sojourn law is known by bounds, and the theory of this controller takes probabilities")
    transition = np.zeros((len(states), len(states)))
    for i, j, (chance, _, _) in steps:
        transition[i, j] += chance
    gains = np.zeros((len(states), reach + 2, *K.shape[2:]))
    renewed = np.zeros((len(states), K.shape[3]), dtype=np.bool_)
    for i, state in enumerate(states):
        phase = counted.of(state.phase, state.sent)
        for sensor, kept in zip(rig.sensors, state.sent):
            own = list(sensor.outputs)
            renewed[i, own] = kept.known > 0
            for j in range(memory + 1) if phase is not None else ():
                older = kept.known >> j
                held = j + (older & -older).bit_length() - 1 if older else None if kept.known else reach + 1
                if held is not None:
                    gains[i, held][:, own] += K[phase, j][:, own]
    for sensor in rig.sensors:  # before the first packet of a node what is held of it is 0, and as good as renewed
        own = list(sensor.outputs)
        for at in np.flatnonzero(~led_to(transition > 0.0, renewed[:, own[0]])):
            gains[at, -1][:, own], renewed[at, own] = 0.0, True
    return _without_unused(gains, transition / transition.sum(axis=1, keepdims=True), np.array(list(states.values())), renewed)


def with_commands(each: PhaseGains, ca: DelayChain, begins: NDArray[np.float64]) -> PhaseGains:
    """Return the phases together with those of the command that acts; as they are where all are as old.

    Args:
        each: the phases of what is known.
        ca: the chain of the ages of commands.
        begins: its distribution in slot 0.

    Raises:
        NotKnown: its probabilities are not known, or there are too many phases.
    """
    if ca.between is not None:
        raise NotKnown("over network.ca the tail of a sojourn law is known by bounds, and gains over historical data take none")
    ages = np.where(ca.holds, -1, ca.delay)
    if (ages == ages[0]).all():
        return replace(each, ages=np.full(len(each.gains), ages[0]))
    if (phases := len(each.gains) * len(ages)) > MOST_STATES:
        raise NotKnown(f"what is known and the ages of commands have {phases} phases together, at most {MOST_STATES}")
    before = cycle(len(each.gains)) if each.transition is None else each.transition
    kron = [np.kron(a, b).astype(np.float64) for a, b in ((before, ca.matrix), (each.start, begins))]
    return PhaseGains(
        gains=np.repeat(each.gains, len(ages), axis=0), transition=kron[0], start=kron[1],
        renewed=None if each.renewed is None else np.repeat(each.renewed, len(ages), axis=0),
        ages=np.tile(ages, len(each.gains)),
    )  # fmt: skip


def _without_unused(
    gains: NDArray[np.float64], transition: NDArray[np.float64], start: NDArray[np.float64], renewed: NDArray[np.bool_]
) -> PhaseGains:
    """The phases without what is held where no gain acts on it."""
    if gains[:, -1].any():
        return PhaseGains(gains=gains, transition=transition, start=start, renewed=renewed)
    last = max(np.flatnonzero(gains.any(axis=(0, 2, 3))).tolist(), default=0)
    return PhaseGains(gains=gains[:, : last + 1], transition=transition, start=start)
