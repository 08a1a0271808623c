"""A controller that keeps the CAN messages it has: packets of the rig become messages of a database, and its commands answers.

`OwnMessages` stands between a link's packets and the bus; the rig knows nothing of it. A command names no question: the one that
comes after a question answers it, and one that came before it answers none, unless the URI says how long a command is valid. In
a slot in which no sample arrives no message leaves, and the last command stands. What a signal cannot hold is sent as the
nearest value that it can, as a converter would; signals that the rig has nothing for have their start values.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from time import monotonic
from typing import TYPE_CHECKING, Final, TypeAlias

from transport.dbc import start_numbers
from transport.links.can_datagram import ERROR, ID_MASK, REMOTE
from transport.links.can_identifiers import derived
from transport.links.message_table import MessageTable
from transport.packets import EMPTY, MORE, ControlPacket, SensorPacket, decode, encode_control, packet_size
from transport.wire import HELLO, echo

if TYPE_CHECKING:
    from transport.can_bus_model.disturbances import BusFault
    from transport.links.hil_frames import HilFrames
    from transport.links.python_can import MessageFrames

    Bus: TypeAlias = HilFrames | MessageFrames

_CONTROL: Final = derived().control.start
_LATE: Final = 64
"""Frames that came before a question, and are looked at in one go, lest a flood of them holds the rig."""
_MALFORMED: Final = (REMOTE, False, b"")
"""What a link counts as malformed."""


class OwnMessages:
    """A bus on which the other end has messages of its own: `transport.links.can_link.Frames` of a rig's link.

    Args:
        bus: the frames.
        table: which signals the values are.
    """

    def __init__(self, bus: Bus, table: MessageTable) -> None:
        self._bus, self._table = bus, table
        self._raw = {key: start_numbers(message) for key, message in table.messages.items()}
        self._inputs = [math.nan] * len(table.inputs)
        self._came_at: dict[int, float] = {}
        self._fresh: set[int] = set()  # commands since the question
        self._part = b""
        self._asked: list[bytes] = []
        self._due: set[int] = set()
        self._sample_ns, self._answers = -1, 0
        self._open: tuple[int, int] | None = None  # slot and echo of the question that a command may answer
        self._ready: deque[tuple[int, bool, bytes]] = deque()

    @property
    def lost(self) -> int:
        """Frames that we did not get because our queue was full."""
        return self._bus.lost

    @property
    def turned_away(self) -> int:
        """How often a newcomer found no free file descriptor here."""
        return self._bus.turned_away

    @property
    def filtered(self) -> int:
        """None: what else is on the controller's bus is no packet that went astray."""
        return 0

    def send_frame(self, identifier: int, data: bytes) -> bool:
        """Take a frame of a sensor packet; with the last one of a slot its messages leave.

        Args:
            identifier: not needed: a packet says its node.
            data: of the frame.

        Returns:
            False where a message found no room at the other end, or the packet has no such values.
        """
        self._part += data
        size = packet_size(self._part)
        if size is None or size > len(self._part):
            return True
        frame, self._part = self._part[:size], b""
        packet = decode(frame)
        if not isinstance(packet, SensorPacket):
            return False
        if not self._asked:
            self._begin_question()
        self._asked.append(frame)
        fits = self._take(packet)
        if packet.flags & MORE:
            return fits
        return self._ask(packet.seq) and fits

    def _begin_question(self) -> None:
        """Take what came since the last question: late commands, which stand as long as they are valid."""
        self._ready.clear()
        self._due.clear()
        for _ in range(_LATE):
            frame = self._bus.recv_frame(0.0)
            if frame is None:
                break
            if frame[0] & ERROR or self._command(*frame) is False:
                self._ready.append(frame if frame[0] & ERROR else _MALFORMED)
        self._fresh.clear()

    def _take(self, packet: SensorPacket) -> bool:
        """Put the values of a packet into their signals; return whether they are numbers, and as many as the signals."""
        nodes, y = self._table.outputs, packet.y
        places = nodes[packet.node] if packet.node < len(nodes) else ()
        if packet.flags & EMPTY:
            places = ()
        elif len(places) * packet.samples != len(y):
            return False
        values = [*zip(places, y), *zip(self._table.references, packet.reference)]  # of the newest sample
        if any(value != value for _, value in values):
            return False
        for place, value in values:
            if place is not None:
                self._raw[place.key][place.signal] = place.sent(value)
        self._due.update(place.key for place in places if place is not None)
        self._sample_ns = max(self._sample_ns, packet.sample_ns) if places else self._sample_ns
        return True

    def _ask(self, seq: int) -> bool:
        """Send the messages of a slot; what has an answer already is answered."""
        table, known = self._table, self._came_at.keys() == self._table.commands
        due = self._due | {place.key for place in table.references if place is not None} - table.measured
        if seq == HELLO:
            due = set() if known else set(table.measured)  # start values, until a controller has said a word
        self._answers = 0 if seq == 0 else self._answers
        self._open = seq, echo(self._asked)
        self._asked = []
        in_order = sorted(due, key=lambda key: (key in table.measured, key))  # samples after references
        reached = [self._send(key) for key in in_order]
        if known and (not due & table.measured or self._stands()):
            self._answer()
        return all(reached)

    def _stands(self) -> bool:
        """Return whether the newest commands are valid still."""
        valid_s = self._table.valid_s
        return valid_s is not None and monotonic() - min(self._came_at.values()) <= valid_s

    def _send(self, key: int) -> bool:
        message, raw = self._table.messages[key], self._raw[key]
        for place in self._table.counters:
            if place.key == key:
                count = raw[place.signal] + 1
                raw[place.signal] = count if place.received(count) == place.received(count) else place.sent(place.low)
        return self._bus.send_as(key, bool(message.is_fd), message.encode(raw, scaling=False, strict=False))

    def recv_frame(self, timeout: float) -> tuple[int, bool, bytes] | None:
        """Return a frame of a control packet, as a controller of the rig's own would send it; or an error frame.

        Args:
            timeout: s; None may come earlier, when another frame came.
        """
        if self._ready:
            return self._ready.popleft()
        frame = self._bus.recv_frame(timeout)
        if frame is None or frame[0] & ERROR:
            return frame
        took = self._command(*frame)
        if took is False:
            return _MALFORMED
        if took and self._open is not None and self._fresh == self._table.commands:
            self._answer()
            return self._ready.popleft()
        return None

    def _command(self, key: int, fd: bool, data: bytes) -> bool | None:
        """Take the inputs of a message; return whether they are some, None for a message that is no command."""
        table = self._table
        if key & ~REMOTE not in table.commands:
            return None
        message = table.messages[key & ~REMOTE]
        if key & REMOTE or fd != bool(message.is_fd) or len(data) < message.length:
            return False
        numbers = message.decode(data[: message.length], decode_choices=False, scaling=False)
        values = [place.received(numbers[place.signal]) if place.key == key else 0.0 for place in table.inputs]
        if any(map(math.isnan, values)):
            return False
        self._inputs = [value if place.key == key else old for place, value, old in zip(table.inputs, values, self._inputs)]
        self._came_at[key] = monotonic()
        self._fresh.add(key)
        return True

    def _answer(self) -> None:
        """Answer the open question with the inputs that are commanded."""
        if self._open is not None:
            (seq, asked), self._open = self._open, None
            self._answers += 1
            rows = (tuple(self._inputs),)
            packet = encode_control(ControlPacket(seq, self._sample_ns, -1, -1, 0, rows, asked, self._answers))
            cut = range(0, len(packet), 64)
            self._ready.extend((_CONTROL + i, True, packet[at : at + 64]) for i, at in enumerate(cut))

    def plan(self, faults: Sequence[BusFault], seed: int, senders: Sequence[Sequence[int]]) -> None:
        """Say what is wrong with the bus when; the commands have identifiers of their own."""
        self._bus.plan(faults, seed, [[], [key & ID_MASK for key in self._table.commands]])

    def shutdown(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()
