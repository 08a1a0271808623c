"""The emulated network of a run as its experiment describes it: from the sensor nodes to the controller, and its faults."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hil.experiment.rig_tables import RESTART, Fault
from hil.rig.loop import Loop
from hil.rig.sensors import Sensor
from hil.rig.slotted_media import slotted
from hil.runtime.nodes import begun, rng_for
from hil.runtime.nodes.journal import Journal
from transport.draws import DELIVERED, DISORDERED, DUPLICATED
from transport.laws import NetworkLaw
from transport.medium import Delivery, FaultedMedium, FaultyPath, IndependentChannels, Medium, OneWay, SampleClock, SplitMedium
from transport.medium.independent import Impairment, impair
from transport.packets import packet_size

if TYPE_CHECKING:
    from hil.runtime.nodes.can_network import CanNetwork


_CAME = frozenset((DELIVERED, DISORDERED, DUPLICATED))


def impaired(loop: Loop, law: NetworkLaw, seed: int, stream: str, first: int = 0) -> Impairment:
    """Return a network law that draws from a stream of its own from a slot on."""
    at = loop.rig.at_controller
    return impair(law, rng_for(seed, begun(stream, first)), at.period_s, at.deadline_s, first)


def sensor_medium_of(loop: Loop, seed: int, bus: CanNetwork | None = None, first: int = 0) -> Medium:
    """Return the medium between the sensor nodes and the controller; every node and every shared medium has its own stream.

    Args:
        loop: the composed experiment.
        seed: seed of the run.
        bus: the CAN bus that takes time, where the experiment has one.
        first: slot in which its laws begin, with streams of their own.
    """
    channels = [impaired(loop, sensor.law, seed, sensor.stream, first) for sensor in loop.rig.sensors]
    medium = _shared_medium(loop, channels, seed, bus) if loop.rig.media else IndependentChannels(channels)
    return NoRepeatMedium(medium) if loop.rig.numbered else medium


class NoRepeatMedium:
    """A medium whose nodes repeat nothing: what has arrived before does not arrive again in a slot in which nothing new came.

    Args:
        medium: the medium behind it.
    """

    def __init__(self, medium: Medium) -> None:
        self.may_send, self.offer, self._collect = medium.may_send, medium.offer, medium.collect

    def collect(self, k: int) -> list[Delivery]:
        """Return what arrived for the first time in slot k, see `Medium.collect`."""
        return [_new(delivery) for delivery in self._collect(k)]


def _new(delivery: Delivery) -> Delivery:
    draws, arrivals = delivery
    return draws, [(g, packet) for g, packet in arrivals if any(d.packet_slot == g and d.reason in _CAME for d in draws)]


def _shared_medium(loop: Loop, channels: Sequence[Impairment], seed: int, bus: CanNetwork | None) -> Medium:
    parts: list[tuple[Sequence[int], Medium]] = []
    for shared in loop.rig.media:
        slots = slotted(shared, loop.rig.sensors)
        if slots is None:
            assert bus is not None
            own = sorted(shared.nodes)
            parts.append((own, bus.to_controller([channels[i] for i in own])))
        else:
            rng = rng_for(seed, f"medium.{shared.name}")
            parts.append((slots.members, slots.running([channels[i] for i in slots.members], rng)))
    others = [i for i in range(len(channels)) if not any(i in nodes for nodes, _ in parts)]
    return SplitMedium([*parts, (others, IndependentChannels([channels[i] for i in others]))] if others else parts)


def clock_of(sensor: Sensor, seed: int) -> SampleClock | None:
    """Return the clock of a sensor node, None for one that has something to send in every slot.

    Args:
        sensor: the node.
        seed: seed of the run.
    """
    table = sensor.clock
    if table.every == 1:
        return None
    rng = rng_for(seed, f"clock.{sensor.name}") if table.drawn else None
    return SampleClock(every=table.every, phase=None if table.random_phase else table.phase, jitter=table.jitter, rng=rng)


class FaultInjector:
    """Breaks the network of a rig as the time line of its experiment says.

    Args:
        loop: the composed experiment; one without faults breaks nothing.
        seed: seed of the run.
        changing: whether faults may come to the time line in the run.
    """

    def __init__(self, loop: Loop, seed: int, changing: bool = False) -> None:
        line = loop.rig.fault_schedule
        self._faults = _in_slots(loop)
        self.there = changing or bool(self._faults)
        self._nodes, self._actuator = [FaultyPath(intervals) for intervals in line.nodes], FaultyPath(line.actuator)
        self._rng = rng_for(seed, "fault")

    def change(self, loop: Loop) -> None:
        """Go on with the time line of a changed experiment."""
        self._faults = _in_slots(loop)
        for path, intervals in zip(self._nodes, loop.rig.fault_schedule.nodes, strict=True):
            path.plan(intervals)
        self._actuator.plan(loop.rig.fault_schedule.actuator)

    def to_controller(self, medium: Medium) -> Medium:
        """Return the way to the controller, with its faults."""
        return FaultedMedium(medium, self._nodes) if self.there else medium

    def to_actuator(self, channel: Impairment) -> Impairment:
        """Return the way to the actuator, with its faults."""
        return OneWay(FaultedMedium(IndependentChannels([channel]), [self._actuator])) if self.there else channel

    def mangled(self) -> list[tuple[int, int, Any]]:
        """Return what arrives in this slot with a flipped bit: (node, slot of its sample, packet)."""
        return [(node, g, packet) for node, path in enumerate(self._nodes) for g, packet in path.mangled]

    def flip(self, frame: bytes) -> bytes:
        """Return a frame with one bit flipped, drawn among those that leave its length as it was."""
        while True:
            place, bit = divmod(int(self._rng.integers(8 * len(frame))), 8)
            wrong = bytes([*frame[:place], frame[place] ^ 1 << bit, *frame[place + 1 :]])
            if packet_size(wrong) == packet_size(frame):
                return wrong

    def log_events(self, t_ns: int, k: int, journal: Journal) -> None:
        """Log the faults that begin or end in slot k.

        Args:
            t_ns: nominal time of the slot, ns.
            k: slot.
            journal: takes the events.
        """
        for i, (first, end, fault) in enumerate(self._faults):
            if k == first:
                kind, message, severity = f"fault: {fault.kind}", fault.text, "warning"
            elif k == end and fault.kind != RESTART:
                kind, message, severity = f"fault over: {fault.kind}", f"{fault.text}: over", "info"
            else:
                continue
            journal.event(
                t_ns, kind, message, slot=k, severity=severity, fault=i, broken=fault.kind, link=fault.link, node=fault.node,
                slots=end - first,
            )  # fmt: skip


def _in_slots(loop: Loop) -> list[tuple[int, int, Fault]]:
    """Return first slot, end and fault of every one on the time line."""
    return [(*fault.slots(float(loop.experiment.period)), fault) for fault in loop.experiment.fault]
