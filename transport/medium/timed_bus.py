"""A CAN bus that takes time, as nodes and receivers see it slot by slot.

Of slot k, sensor packets are queued at :math:`t_k`, what is complete by the deadline :math:`t_k + D` counts in slot k, the
control packet is queued at the deadline, and what is complete by :math:`t_{k+1}` counts in slot k. A packet is complete with the
last bit of EOF of its last frame; its frames hold its values as 32-bit floats, little endian, without a header.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from struct import pack
from typing import Any

from transport.can_bus_model import BitRates, CanFrame, Traffic
from transport.can_bus_model.bus import CanBus, Transmission
from transport.can_bus_model.disturbances import BusFault, PlannedOutages
from transport.can_bus_model.node import Waiting
from transport.draws import REPLACED
from transport.errors import FieldError
from transport.medium import Delivery
from transport.medium.independent import Impairment
from transport.medium.scheduled import Behind
from transport.wire import frame_length


def value_frames(identifier: int, values: Sequence[float], *, fd: bool) -> list[CanFrame]:
    """Return the frames that carry values as 32-bit floats; the identifiers count up.

    Args:
        identifier: of the first frame, 11 bits.
        values: any number of them; beyond the range of a float they become infinities.
        fd: CAN FD with bit-rate switch.

    >>> [(f.identifier, len(f.data)) for f in value_frames(0x100, (1.0, 2.0, 3.0), fd=False)]
    [(256, 8), (257, 4)]
    """
    clipped = [value if abs(value) <= 3.4028234663852886e38 else value * float("inf") for value in values]
    data, step = pack(f"<{len(clipped)}f", *clipped), 64 if fd else 8
    parts = [data[i : i + step] for i in range(0, len(data), step)] or [b""]
    padded = [part.ljust(frame_length(len(part)), b"\0") if fd else part for part in parts]
    return [CanFrame(identifier=identifier + i, data=part, fd=fd, bitrate_switch=fd) for i, part in enumerate(padded)]


@dataclass(eq=False)
class _Packet:
    """A packet of the rig on the bus: whose, of which slot, and its frames that are not sent yet."""

    sender: int
    slot: int
    content: Any
    frames: list[Waiting]
    begun: bool = False


class BusInSlots:
    """The bus, its background traffic, and the packets of the rig's own nodes on it.

    Args:
        bus: the bus; its first nodes are the senders of the rig.
        traffic: what the other nodes queue.
        senders: how many nodes of the rig send.
        overwrite: a newer packet of a sender takes the place of one that waits.
        period_ns: T; slot k begins at k T.
        deadline_ns: D.
        seen: called with everything that ends on the bus.
    """

    def __init__(
        self, bus: CanBus, traffic: Traffic, senders: int, *, overwrite: bool, period_ns: int, deadline_ns: int,
        seen: Callable[[Transmission], None] = lambda transmission: None,
    ) -> None:  # fmt: skip
        self.period_ns, self.deadline_ns = period_ns, deadline_ns
        self._bus, self._traffic, self._overwrite, self._seen = bus, traffic, overwrite, seen
        self._waiting: list[list[_Packet]] = [[] for _ in range(senders)]
        self._came: list[list[_Packet]] = [[] for _ in range(senders)]
        self._past_ns = 0
        self._outages = PlannedOutages()

    def plan(self, faults: Sequence[BusFault]) -> None:
        """Replace the time line of nodes that are off the bus; what is past stays as it was."""
        self._outages.plan(faults, self._past_ns)

    def send(self, sender: int, slot: int, at_ns: int, content: object, frames: Sequence[CanFrame]) -> list[int]:
        """Queue a packet at an instant; return the slots of the older ones whose place it takes.

        An older packet of which a frame was sent, or is being sent, is not replaced.
        """
        self.until(at_ns)
        waiting, replaced = self._waiting[sender], []
        for old in [*waiting] if self._overwrite else ():
            if not old.begun and self._bus.abort(sender, old.frames[0]):
                for behind in old.frames[1:]:
                    self._bus.abort(sender, behind)
                waiting.remove(old)
                replaced.append(old.slot)
        packet = _Packet(sender, slot, content, [])
        for frame in frames:
            packet.frames.append(Waiting(frame, BitRates.units(at_ns), packet))
            self._bus.queue(sender, packet.frames[-1])
        waiting.append(packet)
        return replaced

    def until(self, ns: int) -> None:
        """Let time pass up to an instant."""
        while (edge := self._outages.next_edge(ns)) is not None:
            self._pass(edge)
            self._outages.switch(self._bus, edge)
        self._pass(ns)

    def _pass(self, ns: int) -> None:
        self._past_ns = ns
        for due in self._traffic.until(ns):
            at = BitRates.units(due.at_ns)
            self._take(self._bus.advance(at))
            self._bus.queue(due.node, Waiting(due.frame, at))
        self._take(self._bus.advance(BitRates.units(ns)))

    def _take(self, ended: Sequence[Transmission]) -> None:
        for transmission in ended:
            self._seen(transmission)
            packet = transmission.waiting.tag
            if isinstance(packet, _Packet) and transmission.error_bit is None:
                packet.begun = True
                packet.frames.remove(transmission.waiting)
                if not packet.frames:
                    self._waiting[packet.sender].remove(packet)
                    self._came[packet.sender].append(packet)

    def came(self, sender: int) -> list[tuple[int, object]]:
        """Return (slot, packet) of what has come of a sender since it was last asked, in order."""
        found, self._came[sender] = self._came[sender], []
        return [(packet.slot, packet.content) for packet in found]


class TimedBusWay:
    """Nodes on a CAN bus that takes time; see `transport.medium.Medium`.

    What a sensor node sends is queued when the slot begins and counts up to its deadline, what the controller sends is queued at
    the deadline and counts up to the end of the slot.

    Args:
        bus: shared by sensor nodes and controller where both are on one bus.
        channels: the emulated network of each node behind the bus.
        frames: for each node what makes the frames of a packet.
        first: number of the first of them among the senders of the bus.
        back: whether they send what the controller sends.
    """

    def __init__(
        self, bus: BusInSlots, channels: Sequence[Impairment], frames: Sequence[Callable[[object], Sequence[CanFrame]]],
        *, first: int = 0, back: bool = False,
    ) -> None:  # fmt: skip
        self._bus, self._frames, self._first = bus, tuple(frames), first
        self._queued_ns, self._due_ns = (bus.deadline_ns, bus.period_ns) if back else (0, bus.deadline_ns)
        self._behind = [Behind(channel) for channel in channels]
        self._next = 0

    def may_send(self, node: int, k: int) -> bool:
        """Return True: a node may queue in every slot, and waits for the bus."""
        return True

    def offer(self, node: int, k: int, packet: object) -> None:
        """Queue a packet of slot k, see `Medium.offer`.

        Raises:
            ValueError: slot k has been collected.
        """
        if k < self._next:
            raise FieldError("k", f"slot {k} is offered a packet after it was collected")
        at_ns = k * self._bus.period_ns + self._queued_ns
        replaced = self._bus.send(self._first + node, k, at_ns, packet, self._frames[node](packet))
        self._behind[node].book(k, replaced, REPLACED)

    def collect(self, k: int) -> list[Delivery]:
        """Return what each node's packets have become when what is sent in slot k counts no more, see `Medium.collect`."""
        self._next = k + 1
        self._bus.until(k * self._bus.period_ns + self._due_ns)
        for node, behind in enumerate(self._behind):
            behind.carry(k, self._bus.came(self._first + node))
        return [behind.collect(k) for behind in self._behind]
