"""The chain of the ages at the controller where nodes take turns, wait for a bus, have clocks, or where ages are recorded.

In slot k the newest received packet of a node is the newest that it sent in or before slot k - a(k), where a(k) is the age that a
receiver measures under the node's network law. So a node's state is the state of its law and the packets on their way: for
j = 0, 1, ... the age of the newest sample sent in or before slot k - j, or, under a packet law, the slot in which each packet
comes (`hil.rig.receiver`). A medium's state is the node whose turn it is, or the packets that wait for the bus. All states that
can be reached from slot 0 are enumerated. Samples older than every age that the law draws and the controller distinguishes are
one state: the controller holds the sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import lcm
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hil.experiment.nodes import ClockTable
from hil.rig import RigSpec
from hil.rig.receiver import Chance, Channel, Received, channel_of
from hil.rig.sensors import Sensor
from hil.rig.slotted_media import SlottedMedium, slotted
from transport.errors import NotKnown

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain

MOST_STATES = 1024
"""The theory takes one matrix per state, each on the stacked state."""

BANDS = ("dead-band", "relative")
"""Triggers of a node that is silent only while what it measures is near what it sent."""


class State(NamedTuple):
    """A state of the whole: number of the slot in the cycle, states of clocks, media and laws, packets of nodes on their way.

    Of a clock that draws: in how many slots from the next on its next sample is due, with what it draws and without.
    """

    phase: int
    clocks: tuple[tuple[int, int], ...]
    media: tuple[object, ...]
    laws: tuple[int, ...]
    sent: tuple[Any, ...]


class FollowsPackets(Protocol):
    """A node's channel as far as `explored` asks it, see `hil.rig.receiver.AgeChannel`; what is on its way may be more."""

    @property
    def begins(self) -> tuple[tuple[int, float], ...]:
        """States of the law in slot 0, each with its probability."""

    def follows(self, law_state: int) -> tuple[tuple[int, Chance], ...]:
        """Return the states of the law that follow one."""

    def sends(self, previous: Any, law_state: int, offered: int | None, far: int) -> Iterator[tuple[Any, Chance]]:
        """Yield what is on its way in a slot."""


def received_ages(
    rig: RigSpec, arriving: Sequence[Received], distinguished: int | Sequence[int], *, bands: str = "", in_phase: bool = True
) -> DelayChain:
    """Return the chain of the ages of every output's newest sample at the controller.

    A node with a band around what it sent counts as one that sends whenever it may, unless something keeps that from being known.

    Args:
        rig: its laws' files read.
        arriving: the law of each sensor node, as the controller meets it.
        distinguished: how many ages 0, 1, ... the controller distinguishes, of the oldest sample or of every node; the last for
            all beyond.
        bands: why the error of a node with a dead band or a relative trigger is not bounded, a phrase; empty: it is bounded.
        in_phase: whether the laws begin with the clocks in slot 0; else in any slot of their cycle.

    Raises:
        NotKnown: there is none.
    """
    from design.processes.delay_chain import DelayChain, labels_of

    sensors = rig.sensors
    media, channels = media_and_channels(rig, arriving, bands=bands)
    counts = [distinguished] * len(sensors) if isinstance(distinguished, int) else list(distinguished)
    waits = waiting(sensors, media)  # then a newer sample takes its place
    far = [max(each.oldest + wait, count - 2) + 1 for each, wait, count in zip(channels, waits, counts)]  # received before: held
    states, steps = explored(sensors, media, channels, far, in_phase=in_phase)
    ages = np.zeros((len(states), len(rig.outputs)), dtype=np.int64)
    held, own = np.zeros(ages.shape, dtype=np.bool_), np.zeros((len(sensors), len(states)), dtype=np.int64)
    for i, state in enumerate(states):
        own[:, i] = [each.age(sent, at) for each, sent, at in zip(channels, state.sent, state.laws)]
        for sensor, age, bound in zip(sensors, own[:, i], far):
            ages[i, list(sensor.outputs)], held[i, list(sensor.outputs)] = min(age, bound - 1), age >= bound
    exact = all(low == chance == high for _, _, (chance, low, high) in steps)
    matrices = np.zeros((3, len(states), len(states)))
    for i, j, chances in steps:
        matrices[:, i, j] += chances
    matrices[0] /= matrices[0].sum(axis=1, keepdims=True)
    return DelayChain(
        transition=matrices[0], delays=ages.max(axis=1), labels=labels_of(own, distinguished), ages=ages, held=held,
        begins=np.array(list(states.values())) > 0.0,
        between=None if exact else (np.minimum(matrices[1], matrices[0]), np.clip(matrices[2], matrices[0], 1.0)),
    )  # fmt: skip


def media_and_channels(
    rig: RigSpec, arriving: Sequence[Received], *, bands: str, drawn: bool = False
) -> tuple[list[SlottedMedium], list[Channel]]:
    """Return what nodes share, and the channel of each node; `bands` as of `received_ages`, `drawn` as of `channel_of`.

    Raises:
        NotKnown: what of a node, its law or a medium has no chain.
    """
    media: list[SlottedMedium] = []
    for shared in rig.media:
        if (medium := slotted(shared, rig.sensors)) is None:
            raise NotKnown(f"network.media.{shared.name} is of kind {shared.table.kind!r}, whose delays no chain knows")
        media.append(medium)
    for sensor in rig.sensors:
        kind, trigger = sensor.trigger.kind, f"{sensor.path}.trigger ({sensor.trigger.kind}) lets a node keep silent"
        if kind in BANDS and bands:
            raise NotKnown(f"{bands}: {trigger}, and by how much the sample sent last is wrong is not known then")
        if kind != "every-slot" and kind not in BANDS:
            said = "the sample sent last may be wrong by any amount meanwhile; a dead band or a share has a bound"
            raise NotKnown(f"{trigger}, and {said}")
    channels: list[Channel] = []
    for way, sensor in zip(arriving, rig.sensors):
        try:
            found = channel_of(way, drawn=drawn)
        except NotKnown as why:
            raise NotKnown(f"{way.path}: {why}") from None
        if sensor.trigger.kind in BANDS and not found.sure:
            said = "under a packet law whose ages change it is not known when what a silent node sent last has come"
            raise NotKnown(f"{way.path}: {said}")
        channels.append(found)
    return media, channels


def waiting(sensors: Sequence[Sensor], media: Sequence[SlottedMedium]) -> list[int]:
    """Return for how many slots at most a sample of each node waits for its medium."""
    members = {n for medium in media if medium.waits for n in medium.members}
    return [s.clock.every + s.clock.jitter - 1 if n in members else 0 for n, s in enumerate(sensors)]


def _drawn(clock: ClockTable, state: tuple[int, int] | None) -> Iterator[tuple[bool, tuple[int, int], float]]:
    """Yield whether a clock that draws sends in a slot, its state after it, and the probability; `state` None: in slot 0."""
    if state is None:
        bases = range(clock.every) if clock.random_phase else (clock.phase,)
        for base, late in product(bases, range(clock.jitter + 1)):
            for fires, after, share in _drawn(clock, (base + late, base)):
                yield fires, after, share / len(bases) / (clock.jitter + 1)
        return
    due, base = state
    if due:
        yield False, (due - 1, base - 1), 1.0
        return
    for late in range(clock.jitter + 1):
        yield True, (base + clock.every + late - 1, base + clock.every - 1), 1.0 / (clock.jitter + 1)


def explored(
    sensors: Sequence[Sensor], media: Sequence[SlottedMedium], channels: Sequence[FollowsPackets], far: Sequence[int], *,
    in_phase: bool = True, cycle: int = 1,
) -> tuple[dict[State, float], list[tuple[int, int, Chance]]]:  # fmt: skip
    """Return every reachable state with its probability in slot 0, and the transitions between them.

    Args:
        sensors: the nodes, by number.
        media: what they share.
        channels: of each node.
        far: of each node, the age from which on a sample counts as received before, or never sent.
        in_phase: as of `received_ages`; else slot 0 is any slot of the cycle.
        cycle: slots after which what else counts them begins anew.

    Raises:
        NotKnown: there are too many.
    """
    too_many = f"media, clocks and laws together have more than {MOST_STATES} states"
    draws = [n for n, sensor in enumerate(sensors) if sensor.clock.drawn]
    if draws and not in_phase:
        raise NotKnown(f"{sensors[draws[0]].path}.clock draws when it sends, and the network begins in the run")
    free = [n for n in range(len(sensors)) if not any(n in medium.members for medium in media)]
    cycle = lcm(cycle, *(s.clock.every for s in sensors if not s.clock.drawn), *(medium.cycle for medium in media))
    if cycle > MOST_STATES:
        raise NotKnown(too_many)
    due = [[sensors[n].clock.every == 1 or t % sensors[n].clock.every == sensors[n].clock.phase
            for n in range(len(sensors))] for t in range(cycle)]  # fmt: skip

    def successors(state: State | None, t: int) -> Iterator[tuple[State, Chance]]:
        clocks = [list(_drawn(sensors[n].clock, None if state is None else state.clocks[i])) for i, n in enumerate(draws)]
        for drawn in product(*clocks):
            sends, chance = list(due[t]), 1.0
            for n, (fires, _, share) in zip(draws, drawn):
                sends[n], chance = fires, chance * share
            yield from in_slot(state, t, sends, tuple(after for _, after, _ in drawn), chance)

    def in_slot(
        state: State | None, t: int, sends: Sequence[bool], clocks: tuple[tuple[int, int], ...], drawn: float
    ) -> Iterator[tuple[State, Chance]]:
        law_outcomes = [
            [(at, (share,) * 3) for at, share in channel.begins] if state is None else channel.follows(state.laws[n])
            for n, channel in enumerate(channels)
        ]
        before = [None] * len(media) if state is None else state.media
        medium_outcomes = [list(medium.outcomes(at, t, sends)) for medium, at in zip(media, before)]
        of_free_nodes = {n: 0 for n in free if sends[n]}
        for media_now in product(*medium_outcomes):
            offers, chance = dict(of_free_nodes), drawn
            for _, own, share in media_now:
                offers, chance = offers | own, chance * share
            for laws_now in product(*law_outcomes):
                laws = tuple(at for at, _ in laws_now)
                on_way_outcomes = (
                    channel.sends(None if state is None else state.sent[n], laws[n], offers.get(n), far[n])
                    for n, channel in enumerate(channels)
                )
                for on_way_now in product(*on_way_outcomes):
                    chances = [chance] * 3
                    for _, bounds in (*laws_now, *on_way_now):
                        chances = [a * b for a, b in zip(chances, bounds)]
                    media_states, on_way = tuple(m for m, _, _ in media_now), tuple(samples for samples, _ in on_way_now)
                    yield State(t, clocks, media_states, laws, on_way), tuple(chances)  # type: ignore[misc]

    begun = range(1 if in_phase else cycle)
    reachable: dict[State, float] = {}
    for state, (chance, _, _) in (first for t in begun for first in successors(None, t)):
        reachable[state] = reachable.get(state, 0.0) + chance / len(begun)
    number, unexplored, transitions = {state: i for i, state in enumerate(reachable)}, list(reachable), []
    while unexplored:
        state = unexplored.pop()
        for following, chances in successors(state, (state.phase + 1) % cycle):
            if following not in number:
                number[following] = len(number)
                reachable[following] = 0.0
                unexplored.append(following)
            transitions.append((number[state], number[following], chances))
        if len(number) > MOST_STATES:
            raise NotKnown(too_many)
    return reachable, transitions
