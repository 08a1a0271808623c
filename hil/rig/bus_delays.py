"""The ages that a CAN bus with time makes of the loop's packets: what comes again and again, and between which bounds.

The packet of a slot comes late by so many slots as its response time says; where the bounds of that time lie in different slots,
it comes in any of them, whatever the others do. The newest packet that has come gives the measured age. So a state is the slot's
number in the cycle and the age, and from each state all ages follow that some response times within the bounds lead to.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import lcm
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from hil.rig import RigSpec
from hil.rig.can_bus import analysed, can_bus_of, frame_of, own_packets, rates_of
from hil.rig.delay_chains import chain_of
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


class BusDelays(Struct, frozen=True, kw_only=True):
    """By how many slots the packets of a rig are late on a bus, slot by slot of a cycle that comes again for ever.

    Args:
        sensor: of the sensor node's packets; None in a slot without one.
        control: of the control packets; empty where they do not travel on the bus.
        worst_ns: the longest response time of a sensor packet and of a control packet; the latter 0 where there is none.
    """

    sensor: tuple[Late | None, ...]
    control: tuple[Late, ...]
    worst_ns: tuple[int, int]

    @property
    def exact(self) -> bool:
        """Whether nothing is left open: the ages repeat."""
        return all(late is None or late[0] == late[1] for late in (*self.sensor, *self.control))


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
    for sender, worst_ns, apart in zip(("sensor", "control"), found.worst_ns, (rig.sensors[0].clock.every, 1)):
        if bus.table.buffer == "overwritten" and worst_ns > apart * rig.period_ns:
            raise NotKnown(
                f"network.media.{bus.name}: a {sender} packet may still wait when the next one takes its place; "
                'buffer = "fifo", or less traffic above it'
            )
    return found


def _require_bounded(rig: RigSpec, bus: SharedMedium) -> None:
    """Raise NotKnown with what of the rig or the traffic prevents bounds."""
    at, table = f"network.media.{bus.name}", bus.table
    if len(rig.sensors) > 1:
        raise NotKnown(f"{at}: {len(rig.sensors)} sensor nodes; the ages of one are computed")
    if table.bit_error_rate:
        raise NotKnown(f"{at}.bit_error_rate: disturbed frames are sent again, any number of times, and no bound holds")
    if table.recorded:
        raise NotKnown(f"{at}: frames of a recording have no period, and what follows behind its end is not known")
    sensor = rig.sensors[0]
    if sensor.trigger.kind != "every-slot":
        trigger = f"{sensor.path}.trigger ({sensor.trigger.kind})"
        said = f"the ages over a CAN bus with time are of a node that sends in every slot; {trigger} lets it keep silent"
        raise NotKnown(f"{at}: {said}")
    if sensor.clock.drawn:
        raise NotKnown(f"{sensor.path}.clock draws when it sends")


def _timed(rig: RigSpec, bus: SharedMedium, rows: int | None, longest: bool) -> list[PeriodicMessage]:
    """Return all messages with the instants at which they are due: the rig's own first."""
    fd, sensor, medium = bus.table.dbitrate is not None, rig.sensors[0], bus.table
    deadline_ns = round(rig.at_controller.deadline_s * 1e9)
    offsets = [
        deadline_ns if packet.sender != sensor.name else sensor.clock.phase * rig.period_ns
        for packet in own_packets(rig, bus, rows)
        for _ in packet.sizes(fd=fd)
    ]
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
    """Return the places of the frames with which the packets are complete: the sensor's, then the controller's."""
    ends, at = [], -1
    for packet in own_packets(rig, bus, rows):
        at += len(packet.sizes(fd=bus.table.dbitrate is not None))
        ends.append(at)
    return ends


def _slots(rig: RigSpec) -> tuple[int, int]:
    """Return until when a packet counts in its own slot, in units from when it is queued: a sensor's, a control packet."""
    deadline_ns = round(rig.at_controller.deadline_s * 1e9)
    return BitRates.units(deadline_ns), BitRates.units(rig.period_ns - deadline_ns)


def _late(response: int, within: int, slot: int) -> int:
    """Slots by which a packet is late that takes so long."""
    return max(0, -(-(response - within) // slot))


def _by_slot(rig: RigSpec, bus: SharedMedium, rows: int | None, ranges: ResponseRanges) -> BusDelays:
    cycle, rest = divmod(lcm(ranges.hyperperiod_ns, rig.period_ns), rig.period_ns)
    if rest or cycle > MOST_SLOTS:
        said = f"its traffic comes again after {cycle} slots, at most {MOST_SLOTS} are computed with"
        raise NotKnown(f"network.media.{bus.name}: {said}")
    every, phase = rig.sensors[0].clock.every, rig.sensors[0].clock.phase
    slot, within, ends = BitRates.units(rig.period_ns), _slots(rig), _last_frames(rig, bus, rows)
    begin = cycle * max(-(-ranges.lead[end] // ranges.count[end]) for end in ends)  # slot from which on all comes again
    worst = [0, 0]

    def late(way: int, instance: int) -> Late | None:
        low, high = ranges.of(ends[way], instance)
        worst[way] = max(worst[way], BitRates.ns(high))
        return _late(low, within[way], slot), _late(high, within[way], slot)

    slots = range(begin, begin + cycle)
    sensor = [late(0, (k - phase) // every) if k >= phase and (k - phase) % every == 0 else None for k in slots]
    control = [late(1, k) for k in slots] if len(ends) > 1 else []
    return BusDelays(sensor=tuple(sensor), control=tuple(each for each in control if each), worst_ns=(worst[0], worst[1]))


def _from_any_offset(rig: RigSpec, bus: SharedMedium, rows: int | None, timed: Sequence[PeriodicMessage], why: str) -> BusDelays:
    """Return the bounds that hold whatever the offsets are: the critical instant for every packet."""
    from transport.can_analysis import response_times

    rates, clock = rates_of(bus.table), rig.sensors[0].clock
    bounds = {each.message.name: each.response_ns for each in response_times(timed, rates)}
    found, worst = [], [0, 0]
    for way, end in enumerate(_last_frames(rig, bus, rows)):
        own, within, slot = timed[end], _slots(rig)[way], BitRates.units(rig.period_ns)
        bound = bounds[own.name]
        if bound is None:
            raise NotKnown(f"network.media.{bus.name}: {own.name!r} has no bound: {why}")
        worst[way] = bound
        found.append((_late(rates.duration(own.least_length()), within, slot), _late(BitRates.units(bound), within, slot)))
    sensor = tuple(found[0] if k == clock.phase else None for k in range(clock.every))
    return BusDelays(sensor=sensor, control=tuple(found[1:]), worst_ns=(worst[0], worst[1]))


def bus_chains(rig: RigSpec, rows: int | None = None, *, longest: bool = False) -> tuple[DelayChain, DelayChain]:
    """Return the chains of both ages over the CAN bus of a rig.

    Args:
        rig, rows, longest: as of `bus_delays`; of the longest frames the ages repeat, and a design takes those.

    Raises:
        NotKnown: there are none, or it has no such bus.
    """
    bus = can_bus_of(rig)
    if bus is None:
        raise NotKnown("it has no CAN bus with time")
    found = bus_delays(rig, bus, rows, longest=longest)
    ways = [received(f"{rig.sensors[0].path}.law", rig.sensors[0].law, rig.at_controller)]
    ways += [received("network.ca.law", rig.ca_law, rig.at_actuator)] if bus.table.control else []
    for way in ways:
        if way.states is None or way.states.ages.any():
            said = f"comes behind network.media.{bus.name} and adds ages of its own; a constant age of 0 adds none"
            raise NotKnown(f"{way.path} {said}")
    sc = chain_of_ages(found.sensor, rig.at_controller)
    if bus.table.control:
        return sc, chain_of_ages(found.control, rig.at_actuator)
    applied = received("network.ca.law", rig.ca_law, rig.at_actuator)
    if isinstance(applied.law, RecordedLaw):
        return sc, recorded_chain(applied.law)
    ca = chain_of(applied)
    if ca is None:
        raise NotKnown(f"the law of network.ca {applied.why_none}")
    return sc, ca


def chain_of_ages(packets: Sequence[Late | None], receiver: Receiver) -> DelayChain:
    """Return the chain of the ages at a receiver; where several may follow, their probabilities are not known (0 to 1).

    Args:
        packets: of each slot of a cycle by how many slots its packet is late, at least and at most.
        receiver: who receives.
    """
    from design.processes.delay_chain import DelayChain

    steps = _steps(packets)
    states = sorted(steps)
    index = {state: i for i, state in enumerate(states)}
    low, high = (np.zeros((len(states), len(states))) for _ in range(2))
    for state, following in steps.items():
        for after in following:
            high[index[state], index[after]] = 1.0
            low[index[state], index[after]] = float(len(following) == 1)
    ages = np.array([age for _, age in states], dtype=np.int64)
    oldest = receiver.max_age if receiver.holds_input else max(receiver.max_age, int(ages.max()))
    beyond = bool((ages > receiver.max_age).any())
    return DelayChain(
        transition=high / high.sum(axis=1, keepdims=True), delays=np.minimum(ages, oldest),
        labels=np.minimum(ages, receiver.max_age), between=None if np.array_equal(low, high) else (low, high),
        held=ages > oldest if beyond else None, begins=np.array([phase == 0 for phase, _ in states]),
    )  # fmt: skip


def _steps(packets: Sequence[Late | None]) -> dict[tuple[int, int], set[tuple[int, int]]]:
    """Return every (slot of the cycle, age) that comes again for ever, and what follows it."""
    packets = _shortest(packets)
    cycle = len(packets)

    def after(k: int, age: int) -> set[tuple[int, int]]:
        """The ages that are possible in slot k, of packets sent after the packet that was the newest in the slot before."""
        found, oldest = set(), age + 1
        for own in range(age + 1):  # from the newest on; the first that must have come ends the search
            late = packets[(k - own) % cycle]
            if late is not None and late[0] <= own:
                found.add((k % cycle, own))
                if late[1] <= own:
                    return found
        return found | {(k % cycle, oldest)}

    longest = max(late[1] for late in packets if late is not None) + cycle
    steps: dict[tuple[int, int], set[tuple[int, int]]] = {}
    ahead = [(k, age) for k in range(cycle) for age in range(longest + 1)]
    for k, age in ahead:
        steps[k, age] = after(k + 1, age)
    while True:  # what nothing leads to is left out
        led = set().union(*steps.values())
        kept = {state: following for state, following in steps.items() if state in led}
        if len(kept) == len(steps):
            return kept
        steps = kept


def _shortest(packets: Sequence[Late | None]) -> Sequence[Late | None]:
    """The cycle without its repetitions."""
    for n in range(1, len(packets)):
        if len(packets) % n == 0 and all(packets[k] == packets[k % n] for k in range(len(packets))):
            return packets[:n]
    return packets
