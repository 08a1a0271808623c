"""The ages that a CAN bus with time makes of the loop's packets: what comes again and again, and between which bounds.

The packet of a slot comes late by so many slots as its response time says; where the bounds of that time lie in different slots,
it comes in any of them, whatever the others do. The newest packet that has come gives the measured age. So a state is the slot's
number in the cycle and the age of every sensor node, and from each state all ages follow that some response times within the
bounds lead to.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import lcm, prod
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from hil.rig import RigSpec
from hil.rig.can_bus import analysed, can_bus_of, frame_of, own_packets, rates_of
from hil.rig.delay_chains import chain_of
from hil.rig.received_ages import MOST_STATES
from hil.rig.receiver import Receiver, received, recorded_chain
from hil.rig.sensors import SharedMedium
from transport.can_bus_model import BitRates
from transport.can_bus_model.bits import frame_length
from transport.errors import NotKnown
from transport.laws import RecordedLaw

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain
    from transport.can_analysis import PeriodicMessage
    from transport.can_analysis.response_ranges import ResponseRanges

MOST_SLOTS: Final = 1024
"""Of a cycle: the theory takes a matrix for each of its slots."""

Late = tuple[int, int]
"""Slots by which a packet is late, at least and at most; of a slot without a packet none."""
Packets = tuple[Late | None, ...]
"""Those of a sender, slot by slot of a cycle."""


class BusDelays(Struct, frozen=True, kw_only=True):
    """By how many slots the packets of a rig are late on a bus, slot by slot of a cycle that comes again for ever.

    Args:
        packets: of each sensor node, then of the controller where its packets travel on the bus; None in a slot without one.
        worst_ns: the longest response time of each.
    """

    packets: tuple[Packets, ...]
    worst_ns: tuple[int, ...]

    @property
    def exact(self) -> bool:
        """Whether nothing is left open: the ages repeat."""
        return all(late is None or late[0] == late[1] for own in self.packets for late in own)


def bus_delays(rig: RigSpec, bus: SharedMedium, rows: int | None = None, *, longest: bool = False) -> BusDelays:
    """Return by how many slots packets are late.

    Args:
        rig: its laws' files read.
        bus: its CAN bus.
        rows: of a control packet; by default one for each age.
        longest: take every frame as its longest, and every message as due without jitter: then the ages repeat.

    Raises:
        NotKnown: that has no bound.
    """
    _require_bounded(rig, bus)
    from transport.can_analysis.response_ranges import response_ranges

    rates, timed = rates_of(bus.table), _timed(rig, bus, rows, longest)
    if len({each.key() for each in timed}) < len(timed):
        raise NotKnown(f"two messages of network.media.{bus.name} have one identifier")
    try:
        ranges = response_ranges(timed, rates)
    except NotKnown as why_none:
        if longest:
            raise NotKnown(f"network.media.{bus.name}: {why_none}") from None
        found = _from_any_offset(rig, bus, rows, timed, str(why_none))
    else:
        found = _by_slot(rig, bus, rows, ranges)
    for packet, worst_ns in zip(own_packets(rig, bus, rows), found.worst_ns):
        if bus.table.buffer == "overwritten" and worst_ns > packet.period_ns:
            raise NotKnown(
                f"network.media.{bus.name}: a packet of {packet.sender} may still wait when the next one takes its place; "
                'buffer = "fifo", or less traffic above it'
            )
    return found


def _require_bounded(rig: RigSpec, bus: SharedMedium) -> None:
    """Raise NotKnown with what of the rig or the traffic prevents bounds."""
    at, table = f"network.media.{bus.name}", bus.table
    outside = [sensor.name for number, sensor in enumerate(rig.sensors) if number not in bus.nodes]
    if outside:
        raise NotKnown(f"{at}: node {outside[0]!r} is not on it; ages are computed of nodes that are all on the bus")
    if table.bit_error_rate:
        raise NotKnown(f"{at}.bit_error_rate: disturbed frames are sent again, any number of times, and no bound holds")
    if table.recorded:
        raise NotKnown(f"{at}: frames of a recording have no period, and what follows behind its end is not known")
    for sensor in rig.sensors:
        if sensor.trigger.kind != "every-slot":
            trigger = f"{sensor.path}.trigger ({sensor.trigger.kind})"
            said = f"the ages over a CAN bus with time are of a node that sends in every slot; {trigger} lets it keep silent"
            raise NotKnown(f"{at}: {said}")
        if sensor.clock.drawn:
            raise NotKnown(f"{sensor.path}.clock draws when it sends")


def _timed(rig: RigSpec, bus: SharedMedium, rows: int | None, longest: bool) -> list[PeriodicMessage]:
    """Return all messages with the instants at which they are due: the rig's own first."""
    fd, medium = bus.table.dbitrate is not None, bus.table
    due = [sensor.clock.phase * rig.period_ns for sensor in rig.sensors] + [round(rig.at_controller.deadline_s * 1e9)]
    offsets = [at for packet, at in zip(own_packets(rig, bus, rows), due) for _ in packet.sizes(fd=fd)]
    offsets += [round(float(message.offset) * 1e9) for message in medium.traffic]
    exact = [None] * (len(offsets) - len(medium.traffic)) + [
        frame_length(frame_of(message, medium)) if message.data is not None or not message.length else None
        for message in medium.traffic
    ]
    found = []
    for message, offset, bits in zip(analysed(rig, bus, rows), offsets, exact, strict=True):
        known = message if bits is None else replace(message, bits=bits)
        if longest:
            known, bits = replace(known, jitter_ns=0), known.frame_length()
        found.append(replace(known, offset_ns=offset, shortest=bits))
    return found


def _last_frames(rig: RigSpec, bus: SharedMedium, rows: int | None) -> list[int]:
    """Return the places of the frames with which the packets are complete: the sensor nodes', then the controller's."""
    ends, at = [], -1
    for packet in own_packets(rig, bus, rows):
        at += len(packet.sizes(fd=bus.table.dbitrate is not None))
        ends.append(at)
    return ends


def _within(rig: RigSpec) -> list[int]:
    """Return until when packets count in their own slots, in units from when they are queued: the nodes', the controller's."""
    deadline_ns = round(rig.at_controller.deadline_s * 1e9)
    return [BitRates.units(deadline_ns)] * len(rig.sensors) + [BitRates.units(rig.period_ns - deadline_ns)]


def _clocks(rig: RigSpec) -> list[tuple[int, int]]:
    """Return from slot to slot when packets are sent, and in which first: the nodes', the controller's."""
    return [(sensor.clock.every, sensor.clock.phase) for sensor in rig.sensors] + [(1, 0)]


def _late(response: int, within: int, slot: int) -> int:
    """Slots by which a packet is late that takes so long."""
    return max(0, -(-(response - within) // slot))


def _by_slot(rig: RigSpec, bus: SharedMedium, rows: int | None, ranges: ResponseRanges) -> BusDelays:
    cycle, rest = divmod(lcm(ranges.hyperperiod_ns, rig.period_ns), rig.period_ns)
    if rest or cycle > MOST_SLOTS:
        raise _too_long(bus, cycle)
    slot, ends = BitRates.units(rig.period_ns), _last_frames(rig, bus, rows)
    begin = cycle * max(-(-ranges.lead[end] // ranges.count[end]) for end in ends)  # slot from which on all comes again
    packets, worst_ns = [], []
    for end, within, (every, phase) in zip(ends, _within(rig), _clocks(rig)):
        sent = [divmod(k - phase, every) if k >= phase else (0, 1) for k in range(begin, begin + cycle)]
        ways = [None if between else ranges.of(end, instance) for instance, between in sent]
        packets.append(tuple(way and (_late(way[0], within, slot), _late(way[1], within, slot)) for way in ways))
        worst_ns.append(BitRates.ns(max(way[1] for way in ways if way)))
    return BusDelays(packets=tuple(packets), worst_ns=tuple(worst_ns))


def _too_long(bus: SharedMedium, cycle: int) -> NotKnown:
    return NotKnown(
        f"network.media.{bus.name}: its traffic comes again after {cycle} slots, at most {MOST_SLOTS} are computed with"
    )


def _from_any_offset(rig: RigSpec, bus: SharedMedium, rows: int | None, timed: Sequence[PeriodicMessage], why: str) -> BusDelays:
    """Return the bounds that hold whatever the offsets are: the critical instant for every packet."""
    from transport.can_analysis import response_times

    rates, slot = rates_of(bus.table), BitRates.units(rig.period_ns)
    bounds = {each.message.name: each.response_ns for each in response_times(timed, rates)}
    clocks = _clocks(rig)
    if (cycle := lcm(*(every for every, _ in clocks))) > MOST_SLOTS:
        raise _too_long(bus, cycle)
    packets, worst_ns = [], []
    for end, within, (every, phase) in zip(_last_frames(rig, bus, rows), _within(rig), clocks):
        own = timed[end]
        bound = bounds[own.name]
        if bound is None:
            raise NotKnown(f"network.media.{bus.name}: {own.name!r} has no bound: {why}")
        late = _late(rates.duration(own.least_length()), within, slot), _late(BitRates.units(bound), within, slot)
        packets.append(tuple(late if k % every == phase else None for k in range(cycle)))
        worst_ns.append(bound)
    return BusDelays(packets=tuple(packets), worst_ns=tuple(worst_ns))


def bus_chains(
    rig: RigSpec, rows: int | None = None, *, longest: bool = False, distinguished: int | Sequence[int] | None = None
) -> tuple[DelayChain, DelayChain]:
    """Return the chains of all ages over the CAN bus of a rig.

    Args:
        rig, rows, longest: as of `bus_delays`; of the longest frames the ages repeat, and a design takes those.
        distinguished: over several sensor nodes, how many ages 0, 1, ... the controller distinguishes, of the oldest sample or of
            every node's; by default all of the oldest.

    Raises:
        NotKnown: there are none, or it has no such bus.
    """
    bus = can_bus_of(rig)
    if bus is None:
        raise NotKnown("it has no CAN bus with time")
    found = bus_delays(rig, bus, rows, longest=longest)
    ways = [received(f"{sensor.path}.law", sensor.law, rig.at_controller) for sensor in rig.sensors]
    applied = received("network.ca.law", rig.ca_law, rig.at_actuator)
    for way in (*ways, applied) if bus.table.control else ways:
        if way.states is None or way.states.ages.any():
            said = f"comes behind network.media.{bus.name} and adds ages of its own; a constant age of 0 adds none"
            raise NotKnown(f"{way.path} {said}")
    nodes = found.packets[: len(rig.sensors)]
    if len(nodes) == 1:
        sc = chain_of_ages(nodes[0], rig.at_controller)
    else:
        sc = _chain_of_nodes(nodes, [sensor.outputs for sensor in rig.sensors], distinguished, bus.name)
    if bus.table.control:
        return sc, chain_of_ages(found.packets[-1], rig.at_actuator)
    if isinstance(applied.law, RecordedLaw):
        return sc, recorded_chain(applied.law)
    ca = chain_of(applied)
    if ca is None:
        raise NotKnown(f"the law of network.ca {applied.why_none}")
    return sc, ca


def chain_of_ages(packets: Packets, receiver: Receiver) -> DelayChain:
    """Return the chain of the ages at a receiver; where several may follow, their probabilities are not known (0 to 1).

    Args:
        packets: of each slot of a cycle by how many slots its packet is late, at least and at most.
        receiver: who receives.
    """
    from design.processes.delay_chain import DelayChain

    steps = _Steps([packets])
    ages = steps.ages[:, 0]
    oldest = receiver.max_age if receiver.holds_input else max(receiver.max_age, int(ages.max()))
    beyond = bool((ages > receiver.max_age).any())
    return DelayChain(
        transition=steps.transition, delays=np.minimum(ages, oldest), labels=np.minimum(ages, receiver.max_age),
        between=steps.between, held=ages > oldest if beyond else None, begins=steps.begins,
    )  # fmt: skip


def _chain_of_nodes(
    packets: Sequence[Packets], outputs: Sequence[Sequence[int]], distinguished: int | Sequence[int] | None, bus: str
) -> DelayChain:
    """The chain of the ages of every output's newest sample at the controller; between the bounds each packet may be so late."""
    from design.processes.delay_chain import DelayChain, labels_of

    steps = _Steps(packets, bus)
    ages = np.zeros((len(steps.ages), sum(map(len, outputs))), dtype=np.int64)
    for node, measured in enumerate(outputs):
        ages[:, list(measured)] = steps.ages[:, node, None]
    labels, held = None, None
    if distinguished is not None:  # then one label may have several delays, over a chain that says what is held: nothing
        labels, held = labels_of(steps.ages.T, distinguished), np.zeros(ages.shape, dtype=np.bool_)
    return DelayChain(
        transition=steps.transition, delays=ages.max(axis=1), between=steps.between, begins=steps.begins, ages=ages,
        labels=labels, held=held,
    )  # fmt: skip


class _Steps:
    """The states (slot of the cycle, age of every node) that come again for ever, and what may follow them.

    Attributes:
        ages: (states, nodes).
        transition: (states, states), every state that may follow as likely as the others.
        between: bounds of the probabilities, None where one state follows each.
        begins: (states,) whether the slot is the first of the cycle.
    """

    def __init__(self, packets: Sequence[Packets], bus: str = "") -> None:
        packets = _shortest(packets)
        own = [_steps(each) for each in packets]
        by_slot = [[sorted(age for at, age in steps if at == k) for steps in own] for k in range(len(packets[0]))]
        if (states := sum(prod(map(len, each)) for each in by_slot)) > MOST_STATES:
            raise NotKnown(f"network.media.{bus}: the ages of {len(own)} nodes have {states} states, at most {MOST_STATES}")
        index = {state: i for i, state in enumerate((k, ages) for k, each in enumerate(by_slot) for ages in product(*each))}
        low, high = (np.zeros((len(index), len(index))) for _ in range(2))
        for (k, ages), i in index.items():
            following = [index[(k + 1) % len(by_slot), after] for after in product(*(own[n][k, a] for n, a in enumerate(ages)))]
            high[i, following] = 1.0
            low[i, following] = float(len(following) == 1)
        self.ages = np.array([ages for _, ages in index], dtype=np.int64)
        self.transition = high / high.sum(axis=1, keepdims=True)
        self.between = None if np.array_equal(low, high) else (low, high)
        self.begins = np.array([k == 0 for k, _ in index])


def _steps(packets: Packets) -> dict[tuple[int, int], set[int]]:
    """Return every (slot of the cycle, age) of a node that comes again for ever, and the ages that may follow it."""
    cycle = len(packets)

    def after(k: int, age: int) -> set[int]:
        """The ages that are possible in slot k, of packets sent after the packet that was the newest in the slot before."""
        found, oldest = set(), age + 1
        for own in range(age + 1):  # from the newest on; the first that must have come ends the search
            late = packets[(k - own) % cycle]
            if late is not None and late[0] <= own:
                found.add(own)
                if late[1] <= own:
                    return found
        return found | {oldest}

    longest = max(late[1] for late in packets if late is not None) + cycle
    steps = {(k, age): after(k + 1, age) for k in range(cycle) for age in range(longest + 1)}
    while True:  # what nothing leads to is left out
        led = {((k + 1) % cycle, age) for (k, _), following in steps.items() for age in following}
        kept = {state: following for state, following in steps.items() if state in led}
        if len(kept) == len(steps):
            return kept
        steps = kept


def _shortest(packets: Sequence[Packets]) -> list[Packets]:
    """The cycle of all nodes without its repetitions."""
    cycle = len(packets[0])
    n = next(n for n in range(1, cycle + 1) if cycle % n == 0 and all(own == own[:n] * (cycle // n) for own in packets))
    return [own[:n] for own in packets]
