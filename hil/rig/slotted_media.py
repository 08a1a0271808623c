"""Media that share slots out: of each kind what the theory takes of it, what may follow a state, and the medium that runs.

A further kind is a function in `KINDS`, its keys in `hil.experiment.nodes.Medium`, and what runs in `transport.medium`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from math import lcm
from typing import Any, Final, NamedTuple

import numpy as np

from design.controllers import SensorNodes, Turns
from hil.experiment.nodes import ClockTable
from hil.rig.sensors import Sensor, SharedMedium
from transport.errors import NotKnown
from transport.laws import ChainLaw, NetworkLaw, RecordedLaw, SemiMarkovLaw
from transport.medium import Medium
from transport.medium.independent import Impairment

Samples = tuple[tuple[int, int], ...]  # (node, age of its sample) each
Offers = dict[int, int]  # node: age of the sample that it sends in this slot
Outcomes = Iterator[tuple[Any, Offers, float]]  # state that follows, what gets through, probability


class SlottedMedium(NamedTuple):
    """A medium that several sensor nodes share, of which some send in a slot.

    Attributes:
        members: its nodes, in the order in which the medium that runs counts them.
        turns: what the theory takes of it; raises NotKnown where there is no theory.
        outcomes: what may happen in a slot: after a state (None: before slot 0), t slots into a cycle, with these nodes due.
        running: the medium that runs, over the channel of each member; nothing else may draw from its stream.
        cycle: slots after which its schedule begins anew; 1 where no slot is set apart from others.
        waits: whether a packet that is not carried waits, so that others are carried sooner while a node is silent.
    """

    members: tuple[int, ...]
    turns: Callable[[], Turns]
    outcomes: Callable[[Any, int, Sequence[bool]], Outcomes]
    running: Callable[[Sequence[Impairment], np.random.Generator], Medium]
    cycle: int = 1
    waits: bool = False


def _kept(sending: Sequence[tuple[int, int]], loss: float) -> Iterator[tuple[Offers, float]]:
    """Yield the packets that are not lost, of (node, age of its sample), with their probability."""
    for lost in product(*([(False, 1.0 - loss), (True, loss)] if loss else [(False, 1.0)] for _ in sending)):
        share = 1.0
        for _, chance in lost:
            share *= chance
        yield {node: age for (node, age), (gone, _) in zip(sending, lost) if not gone}, share


def in_order(shared: SharedMedium, sensors: Sequence[Sensor]) -> SlottedMedium:
    """One node in a slot, in an order that comes again."""
    table, nodes, members = shared.table, shared.nodes, tuple(sorted(set(shared.nodes)))

    def outcomes(before: Any, t: int, due: Sequence[bool]) -> Outcomes:
        node = nodes[(t + table.phase) % len(nodes)]
        for offers, share in _kept([(node, 0)] if due[node] else [], table.loss):
            yield None, offers, share

    def running(channels: Sequence[Impairment], rng: np.random.Generator) -> Medium:
        from transport.medium.scheduled import RoundRobin, ScheduledMedium

        return ScheduledMedium(channels, RoundRobin(map(members.index, nodes), table.phase, table.loss, rng))

    turns = Turns(order=nodes, phase=table.phase, loss=table.loss)
    return SlottedMedium(members, lambda: turns, outcomes, running, cycle=len(nodes))


def by_chance(shared: SharedMedium, sensors: Sequence[Sensor]) -> SlottedMedium:
    """One node in a slot, by chance; the state is the place of the last one in the order of the medium."""
    table, nodes, members = shared.table, shared.nodes, tuple(sorted(shared.nodes))
    matrix, shares = table.transition(), table.shares()

    def turns() -> Turns:
        place = [nodes.index(node) for node in range(len(nodes))]
        transition = tuple(tuple(matrix[a][b] for b in place) for a in place)
        return Turns(transition=transition, initial=tuple(shares[a] for a in place), loss=table.loss)

    def outcomes(before: Any, t: int, due: Sequence[bool]) -> Outcomes:
        for at, chance in enumerate(shares if before is None else matrix[before]):
            for offers, share in _kept([(nodes[at], 0)] if due[nodes[at]] else [], table.loss) if chance else ():
                yield at, offers, share * chance

    def running(channels: Sequence[Impairment], rng: np.random.Generator) -> Medium:
        from transport.medium.scheduled import RandomTurns, ScheduledMedium

        return ScheduledMedium(channels, RandomTurns(map(members.index, nodes), matrix, shares, table.loss, rng))

    return SlottedMedium(members, turns, outcomes, running)


def arbitrated(shared: SharedMedium, sensors: Sequence[Sensor]) -> SlottedMedium:
    """The lowest CAN identifiers win; the state is what waits, as (node, age of its sample)."""
    table, members = shared.table, tuple(sorted(shared.nodes, key=lambda node: sensors[node].can_id))

    def turns() -> Turns:
        return Turns(received=bus_cycle([s.clock for s in sensors], table.frames, [s.can_id for s in sensors]), loss=table.loss)

    def outcomes(before: Any, t: int, due: Sequence[bool]) -> Outcomes:
        first, left = _arbitrated(before or (), due, members, table.frames)
        for offers, share in _kept(first, table.loss):
            yield left, offers, share

    def running(channels: Sequence[Impairment], rng: np.random.Generator) -> Medium:
        from transport.medium.scheduled import ArbitratedBus

        return ArbitratedBus(channels, table.frames, table.loss, rng)

    return SlottedMedium(members, turns, outcomes, running, waits=True)


def _arbitrated(before: Samples, due: Sequence[bool], order: Sequence[int], frames: int) -> tuple[Samples, Samples]:
    """What the bus carries in a slot and what waits on, by what waited before it: (node, age of its sample) each."""
    waiting = {node: age + 1 for node, age in before} | {node: 0 for node in order if due[node]}
    first = tuple((node, waiting.pop(node)) for node in [node for node in order if node in waiting][:frames])
    return first, tuple(sorted(waiting.items()))


KINDS: Final = {"round-robin": in_order, "random": by_chance, "can-arbitration": arbitrated}


def slotted(shared: SharedMedium, sensors: Sequence[Sensor]) -> SlottedMedium | None:
    """Return a medium that shares slots out, None for a CAN bus in time.

    Args:
        shared: the medium.
        sensors: all nodes, by number.
    """
    made = KINDS.get(shared.table.kind)
    return None if made is None else made(shared, sensors)


def sensor_nodes(sensors: Sequence[Sensor], shared: Sequence[SharedMedium]) -> SensorNodes:
    """Return the sensor nodes as a controller and the theory see them.

    Args:
        sensors: the nodes, by number.
        shared: media on which they take turns.
    """
    mixed = len(shared) > 1 or any(set(medium.nodes) != set(range(len(sensors))) for medium in shared)
    alone = bool(shared) and not mixed
    slots = slotted(shared[0], sensors) if alone else None
    turns = None
    unforeseen = "the theory knows no chain of the delays that a CAN bus in time makes" if alone and slots is None else ""
    try:
        turns = None if slots is None else slots.turns()
    except NotKnown as why:
        unforeseen = str(why)
    waits = slots is not None and slots.waits
    return SensorNodes(
        names=tuple(s.name for s in sensors),
        outputs=tuple(s.outputs for s in sensors),
        buffers=tuple(s.buffer for s in sensors),
        delays=tuple(_constant_delay(s.law) for s in sensors),
        turns=turns,
        silent=tuple(s.name for s in sensors if s.trigger.kind != "every-slot" or (s.clock.every > 1 and not waits)),
        mixed=mixed,
        unforeseen=unforeseen,
    )


def _constant_delay(law: NetworkLaw) -> int | None:
    if isinstance(law, RecordedLaw) or not isinstance(law, ChainLaw | SemiMarkovLaw):
        return None
    age, *others = set(law.mode_ages)
    return None if others else int(age)


MOST_PHASES = 64
"""The theory takes one matrix per slot of the cycle, each on the stacked state."""


def bus_cycle(clocks: Sequence[ClockTable], frames: int, identifiers: Sequence[int] = ()) -> tuple[Samples, ...]:
    """Return in every slot of the cycle, from slot 0, the (node, age) that the bus carries.

    There is one where the clocks of its nodes draw nothing.

    The bus is run until what waits is as it was before. What is carried in the first slots may lack samples from before slot 0
    only, which were zero and are not needed.

    Args:
        clocks: of all nodes, by number.
        frames: frames that the bus carries in a slot.
        identifiers: of all nodes, of which the lowest wins; by default their numbers.

    Raises:
        NotKnown: there is no such cycle, or it is too long.
    """
    order = sorted(range(len(clocks)), key=lambda node: identifiers[node] if identifiers else node)
    drawn = [i for i, clock in enumerate(clocks) if clock.drawn]
    if drawn:
        raise NotKnown(f"the theory knows no bus whose nodes have clocks that draw: nodes {drawn}")
    common = lcm(*(clock.every for clock in clocks))
    if common > MOST_PHASES:
        said = f"the clocks of the nodes come together every {common} slots"
        raise NotKnown(f"{said}, the theory takes cycles of {MOST_PHASES} slots")
    waits: Samples = ()
    carried: list[Samples] = []
    seen: dict[Samples, int] = {}
    while len(carried) % common or waits not in seen:
        k = len(carried)
        if k % common == 0:
            seen[waits] = k
        now, waits = _arbitrated(waits, [k % clock.every == clock.phase for clock in clocks], order, frames)
        carried.append(now)
    first = seen[waits]
    period = len(carried) - first
    if period > MOST_PHASES:
        raise NotKnown(f"the bus repeats itself every {period} slots, the theory takes cycles of {MOST_PHASES} slots")
    cycle = tuple(carried[first + (k - first) % period] for k in range(period))
    for k in range(first):
        if carried[k] != tuple((node, age) for node, age in cycle[k % period] if age <= k):
            raise NotKnown(f"the bus needs {first} slots until it repeats itself, and the theory takes it from slot 0")
    return cycle
