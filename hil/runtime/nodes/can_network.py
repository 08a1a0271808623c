"""The CAN bus of a run that takes time, with the rig's own nodes and the background traffic on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import cast

from hil.experiment import Experiment
from hil.rig.can_bus import CONTROLLER, RECORDING, bus_nodes, own_packets, periodic_traffic, rates_of
from hil.rig.loop import Loop
from hil.rig.named_files import due_of
from hil.rig.schedules import bus_faults
from hil.rig.sensors import SharedMedium
from hil.runtime.nodes import rng_for
from transport.can_bus_model import CanFrame, Due, Traffic
from transport.can_bus_model.bus import CanBus, Transmission
from transport.can_bus_model.disturbances import BitErrors, PlannedErrors
from transport.can_bus_model.node import CanNode
from transport.medium import OneWay
from transport.medium.independent import Impairment
from transport.medium.timed_bus import BusInSlots, TimedBusWay, value_frames
from transport.packets import ControlPacket

Seen = Callable[[Transmission, CanNode], None]
Status = Callable[[int, str, CanNode], None]


class CanNetwork:
    """The bus of one run.

    Args:
        loop: the composed experiment.
        shared: its CAN bus.
        seed: seed of the run.
        seen: called with everything that ends on the bus, and who sent it.
        status: called with (session time in ns, name, node) when the error state of a node has changed.
    """

    def __init__(self, loop: Loop, shared: SharedMedium, seed: int, seen: Seen, status: Status) -> None:
        e, medium, name = loop.experiment, shared.table, shared.name
        rates, names = rates_of(medium), bus_nodes(loop.rig, shared)
        self._fd = medium.dbitrate is not None
        self._own = own_packets(loop.rig, shared, loop.rows)
        self._carries_control = medium.control
        always = BitErrors(medium.bit_error_rate, rng_for(seed, f"medium.{name}")) if medium.bit_error_rate else None
        self._errors = PlannedErrors(always, rng_for(seed, f"fault.{name}"))
        self._names = names
        nodes = [CanNode("fifo" if name == RECORDING else "priority") for name in names]
        bus = CanBus(rates, nodes, self._errors, status=lambda at, i: status(rates.ns(at), names[i], nodes[i]))
        traffic = periodic_traffic(medium, {name: i for i, name in enumerate(names)})
        sources: list[Iterator[Due]] = [
            each.frames(rng_for(seed, f"medium.{name}.{message.said}"))
            for each, message in zip(traffic, medium.traffic, strict=True)
        ]
        if medium.recorded:
            sources.append(due_of(line, len(names) - 1) for line in medium.recorded)
        self._slots = BusInSlots(
            bus, Traffic(sources), len(self._own), overwrite=medium.buffer == "overwritten", period_ns=e.period_ns,
            deadline_ns=round(e.timing.deadline * e.period_ns), seen=lambda ended: seen(ended, nodes[ended.node]),
        )  # fmt: skip
        self.plan(e)

    def plan(self, e: Experiment) -> None:
        """Take the faults on the time line of an experiment; what is past stays as it was."""
        faults = bus_faults(e, self._names, CONTROLLER)
        self._errors.plan(faults)
        self._slots.plan(faults)

    def to_controller(self, channels: Sequence[Impairment]) -> TimedBusWay:
        """Return the medium of the sensor nodes on the bus.

        Args:
            channels: behind the bus, of each node on it by number.
        """
        frames = [partial(value_frames, packet.first, fd=self._fd) for packet in self._own[: len(channels)]]
        return TimedBusWay(self._slots, channels, frames)

    def to_actuator(self, channel: Impairment) -> Impairment:
        """Return the way to the actuator: over the bus, or past it.

        Args:
            channel: behind the bus.
        """
        if not self._carries_control:
            return channel
        way = TimedBusWay(self._slots, [channel], [self._control_frames], first=len(self._own) - 1, back=True)
        return OneWay(way)

    def _control_frames(self, packet: object) -> list[CanFrame]:
        rows = cast(ControlPacket, packet).rows
        return value_frames(self._own[-1].first, [value for row in rows for value in row], fd=self._fd)
