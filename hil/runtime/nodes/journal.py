"""What is recorded of a slot, and in which topic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from math import nan
from typing import TYPE_CHECKING, Any

from hil.log import SlotRecord, topics
from hil.log.records import Channel
from hil.log.topics import EXTENDED, FD, REMOTE, SWITCH
from hil.log.write import Sink, record_to, records_to
from hil.runtime.nodes.actuator_node import Applied
from hil.runtime.nodes.safety import Injected
from transport.can_bus_model import BitRates
from transport.draws import Draw
from transport.links.can_identifiers import Identifiers
from transport.medium import Delivery
from transport.packets import ControlPacket, node_of

if TYPE_CHECKING:
    from transport.can_bus_model.bus import Transmission
    from transport.can_bus_model.node import CanNode

_SENSED = (topics.STATE.name, topics.MEASUREMENT.name, topics.REFERENCE.name)
_ANSWERED = (topics.CONTROL.name, topics.ROWS.name)
_DRAWS = range(1, 4)
"""How many decisions a network law takes in a slot that is recorded at once."""


class Journal:
    """Packs the records of a rig and hands them to a sink; what is not kept is not packed.

    Args:
        sink: where records go.
        channels: the table of what is logged.
        row_values: values of a control packet that its record holds, rows times inputs.
        numbers: of each sensor node what a record of its draws holds of its number: the number, or nothing.
        identifiers: CAN identifiers, where the record of a frame holds the first of its packet.
    """

    def __init__(
        self, sink: Sink, channels: Mapping[str, Channel], row_values: int, numbers: Sequence[tuple[int, ...]] = ((),),
        identifiers: Identifiers | None = None,
    ) -> None:  # fmt: skip
        self.event = sink.event
        self._log = {topic: record_to(sink, channel) for topic, channel in channels.items()}
        self._state = self._log[topics.STATE.name]
        self._y = self._log[topics.MEASUREMENT.name]
        self._r = self._log[topics.REFERENCE.name]
        self._u = self._log[topics.APPLIED.name]
        self._rows = self._log[topics.ROWS.name]
        self._sensor = self._log[topics.SENSOR.name]
        self._control = self._log[topics.CONTROL.name]
        self._passivity = self._log.get(topics.PASSIVITY.name)
        self._bus = self._log.get(topics.BUS.name)
        filled = [(topics.TOPICS[topic].values, record) for topic, record in self._log.items()]
        self._filled = [(values, record) for values, record in filled if values is not None and record is not None]
        self._sensed: tuple[Any, ...] = ()  # what was asked in the slot, where a topic is filled from it
        self._row_values, self._numbers = row_values, tuple(numbers)
        # What the record of a frame holds of its identifier: the identifier, or nothing.
        self._sensor_ids = [(own[0],) for own in identifiers.sensors] if identifiers else [()] * len(self._numbers)
        self._control_id = (identifiers.control[0],) if identifiers else ()
        self._nowhere = (-1,) if identifiers else ()
        self._asked_at_once = {n: records_to(sink, (*_SENSED, *[topics.SC.name] * n, topics.SENSOR.name)) for n in _DRAWS}
        self._answered_at_once = {n: records_to(sink, (topics.APPLIED.name, *[topics.CA.name] * n, *_ANSWERED)) for n in _DRAWS}

    def slot_asked(
        self, t_ns: int, k: int, state: Sequence[float], y: Sequence[float], r: Sequence[float],
        sent: Sequence[Delivery], frames: Sequence[bytes],
    ) -> None:  # fmt: skip
        """Record what was sensed in slot k, what the network decided about each sensor node, and what was asked."""
        if self._filled:
            self._sensed = (tuple(state), tuple(y), tuple(r), tuple(frames))
        draws, numbers = sent[0][0], self._numbers
        at_once = self._asked_at_once.get(len(draws)) if len(sent) == 1 == len(frames) else None
        if at_once is not None:  # the usual slot: with the other such place 20 % of an interpreted virtual slot with its log
            at_once(t_ns, (*state, k, *y, k, *r, k, *_values_of(draws, numbers[0]), k, *self._sensor_ids[0], 0, frames[0]))
            return
        self.sensed(t_ns, k, state, y, r)
        for (draws, _), number in zip(sent, numbers):
            self.draws(topics.SC.name, t_ns, draws, number)
        self.asked(t_ns, k, frames)

    def slot_answered(
        self, t_ns: int, k: int, applied: Applied, w: Sequence[float], draws: Sequence[Draw], packet: ControlPacket | None,
        data: bytes,
    ) -> None:  # fmt: skip
        """Record what the actuator applied in slot k, what the network decided about it, and the answer, None if none came."""
        u, packet_slot, d, row, status, _, injected = applied
        if self._filled:
            self._fill(t_ns, k, applied, w, data)
        at_once = self._answered_at_once.get(len(draws))
        if at_once is not None and injected is None and packet is not None:
            _, sample_ns, control_ns, tau, selection, rows, _, _ = packet
            if rows and len(rows) * len(rows[0]) == self._row_values:  # the usual slot, see `slot_asked`
                at_once(t_ns, (
                    *u, *w, k, packet_slot, d, row, status, *_values_of(draws), k, *self._control_id, 0, data,
                    *chain.from_iterable(rows), sample_ns, control_ns, k, tau, selection,
                ))  # fmt: skip
                return
        self.applied(t_ns, k, applied, w)
        if injected is not None:
            self.injected(t_ns, k, injected)
        self.draws(topics.CA.name, t_ns, draws)
        if packet is not None:
            self.answered(t_ns, k, packet, data)

    def _fill(self, t_ns: int, k: int, applied: Applied, w: Sequence[float], data: bytes) -> None:
        """Write the topics that say themselves what they hold of a slot."""
        u, _, d, row, status, *_ = applied
        state, y, r, frames = self._sensed
        slot = SlotRecord(
            k=k, t_ns=t_ns, state=state, y=y, r=r, u=u, w=w, d=d, row=row, status=status, frames=frames, answer=data or b"",
        )  # fmt: skip
        for values, record in self._filled:
            found = values(slot)
            if found is not None:
                record(t_ns, found)

    def sensed(self, t_ns: int, k: int, state: Sequence[float], y: Sequence[float], r: Sequence[float]) -> None:
        """Record the plant's state, its outputs and the reference in slot k."""
        if self._state:
            self._state(t_ns, (*state, k))
        if self._y:
            self._y(t_ns, (*y, k))
        if self._r:
            self._r(t_ns, (*r, k))

    def asked(self, t_ns: int, k: int, frames: Sequence[bytes]) -> None:
        """Record the sensor frames of slot k."""
        if self._sensor:
            for frame in frames:
                self._sensor(t_ns, (k, *self._sensor_id(frame), 0, frame))

    def _sensor_id(self, frame: bytes) -> tuple[int, ...]:
        """Return what the record of a sensor frame holds; -1 if its mangled number names no node, as no node sends it then."""
        own = self._sensor_ids
        node = node_of(frame) if len(own) > 1 else 0
        return own[node] if node < len(own) else self._nowhere

    def draws(self, topic: str, t_ns: int, draws: Sequence[Draw], number: tuple[int, ...] = ()) -> None:
        """Record the decisions of a network law, with the number of the node where the log has it."""
        log = self._log[topic]
        if log:
            for slot, packet_slot, mode, age, latency_s, reason in draws:
                log(t_ns, (latency_s, slot, packet_slot, mode, age, *number, reason))

    def applied(self, t_ns: int, k: int, applied: Applied, w: Sequence[float]) -> None:
        """Record what the actuator applied in slot k, and the disturbance w that comes on top."""
        if self._u:
            u, packet_slot, d, row, status, *_ = applied
            self._u(t_ns, (*u, *w, k, packet_slot, d, row, status))

    def injected(self, t_ns: int, k: int, injected: Injected) -> None:
        """Record what the passivity controller saw and did in slot k."""
        if self._passivity:
            self._passivity(t_ns, (*injected, k))

    def answered(self, t_ns: int, k: int, packet: ControlPacket, data: bytes) -> None:
        """Record the control packet that answered slot k in time."""
        if self._control:
            self._control(t_ns, (k, *self._control_id, 0, data))
        if self._rows:
            values = [v for row in packet.rows for v in row][: self._row_values]
            values += [nan] * (self._row_values - len(values))
            self._rows(t_ns, (*values, packet.sample_ns, packet.control_ns, k, packet.tau, packet.selection))

    def bus(self, t_ns: int, k: int, ended: Transmission, node: CanNode) -> None:
        """Record a frame that was on the emulated CAN bus, and got through or was destroyed."""
        if self._bus:
            frame, waiting, error = ended.waiting.frame, ended.waiting, ended.error_bit
            flags = EXTENDED * frame.extended | REMOTE * frame.remote | FD * frame.fd | SWITCH * frame.bitrate_switch
            instants = map(BitRates.ns, (waiting.queued, ended.start, ended.end, ended.idle))
            number, broken = (-1, 0) if error is None else (error, 1)
            self._bus(t_ns, (
                *instants, k, frame.identifier, ended.node, waiting.lost, number, node.errors.tec, broken, flags, len(frame.data),
            ))  # fmt: skip

    def late(self, t_ns: int, seq: int, data: bytes) -> None:
        """Record a control frame that came too late for the slot that it answers."""
        if self._control:
            self._control(t_ns, (seq, *self._control_id, 1, data))


def _values_of(draws: Sequence[Draw], number: tuple[int, ...] = ()) -> Sequence[float]:
    """Return the fields of the records of some decisions, one after the other."""
    values: tuple[float, ...] = ()
    for slot, packet_slot, mode, age, latency_s, reason in draws:
        values += (latency_s, slot, packet_slot, mode, age, *number, reason)
    return values
