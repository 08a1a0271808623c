"""A CAN frame as a datagram between participants of the `hil` bus, as a frame with bits, and as an error frame.

Error frames are as a driver of SocketCAN makes them: what a CAN controller says of a destroyed frame, and of its own state.
A destroyed frame is `CAN_ERR_PROT | CAN_ERR_BUSERROR` as with ``berr-reporting on``: in byte 2 what the node saw, in byte 3 in
which field; a frame that no node acknowledged is `CAN_ERR_ACK` as well. A change of state is `CAN_ERR_CRTL` with the state of
the larger counter in byte 1, or `CAN_ERR_BUSOFF`; `CAN_ERR_RESTARTED` comes with the way back. Bytes 6 and 7 of a change of state
are TEC and REC.

Reference: linux/can/error.h; can_change_state in drivers/net/can/dev/dev.c.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from struct import Struct
from typing import Any, Final, NamedTuple

from transport.can_bus_model import CanFrame
from transport.can_bus_model.bits import wire_bits
from transport.can_bus_model.node import PASSIVE, WARNING, State
from transport.links import BusStatus
from transport.wire import frame_length

FRAME: Final = Struct("<dHIBB")
"""Time stamp, frames lost before (see `mesh_members.HEAD`); identifier with flags, length, FD flags; then data."""

# The bits of <linux/can.h>; of CAN FD: bit rate switch, error state indicator, FD format.
EXTENDED: Final = 0x80000000
REMOTE: Final = 0x40000000
ERROR: Final = 0x20000000
ID_MASK: Final = 0x1FFFFFFF
BRS: Final = 0x01
ESI: Final = 0x02
FDF: Final = 0x04
OWN: Final = 0x80
LOOK: Final = 0x40
"""Flags of ours: a frame of one's own; no frame, but a word that the error state of a participant has changed."""


def matches_of(filters: Iterable[Mapping[str, Any]]) -> tuple[tuple[int, int], ...]:
    """Return acceptance filters, as python-can writes them, as pairs of identifier and mask with the flags of <linux/can.h>.

    Args:
        filters: ``can_id`` and ``can_mask`` of each, and whether it is of ``extended`` identifiers.
    """
    matches = []
    for rule in filters:
        can_id, mask = rule["can_id"] & ID_MASK, rule["can_mask"] & ID_MASK
        if "extended" in rule:
            can_id |= EXTENDED if rule["extended"] else 0
            mask |= EXTENDED
        matches.append((can_id, mask))
    return tuple(matches)


def frame_of(identifier: int, length: int, flags: int, data: bytes | bytearray) -> CanFrame:
    """Return what travels of a frame; CAN FD data are padded to a length that a frame has."""
    fd, remote = bool(flags & FDF), bool(identifier & REMOTE)
    padded = b"" if remote else bytes(data).ljust(frame_length(len(data)) if fd else len(data), b"\0")
    return CanFrame(
        identifier=identifier & ID_MASK, extended=bool(identifier & EXTENDED), remote=remote, data=padded, fd=fd,
        dlc=min(length, 8) if remote else None,
        bitrate_switch=fd and bool(flags & BRS), error_state=fd and bool(flags & ESI),
    )  # fmt: skip


CONTROLLER, PROTOCOL, ACKNOWLEDGE, BUS_OFF, BUS_ERROR, RESTARTED = 0x004, 0x008, 0x020, 0x040, 0x080, 0x100
_BIT0, _BIT1, _BY_SENDER = 0x08, 0x10, 0x80
_ACTIVE: Final = 0x40
_RECEIVE: Final[dict[int, int]] = {0: 0, 1: 0x04, 2: 0x10}  # by level: CAN_ERR_CRTL_RX_WARNING, RX_PASSIVE
_TRANSMIT: Final[dict[int, int]] = {0: 0, 1: 0x08, 2: 0x20}

_CRC, _CRC_DELIMITER, _ACK, _ACK_DELIMITER, _EOF = 0x08, 0x18, 0x19, 0x1B, 0x1A
_DATA, _DLC, _RES0, _RES1, _RTR, _IDE, _SRTR = 0x0A, 0x0B, 0x09, 0x0D, 0x0C, 0x05, 0x04
_BASE: Final = ((1, 0x03), (8, 0x02), (3, 0x06))  # start of frame, identifier bits 28 to 21, 20 to 18
_REST: Final = ((5, 0x07), (8, 0x0F), (5, 0x0E))  # identifier bits 17 to 13, 12 to 5, 4 to 0


class ErrorFrame(NamedTuple):
    """An error frame without its flag.

    Attributes:
        kind: error classes, CAN_ERR_*.
        data: 8 bytes.
    """

    kind: int
    data: bytes


def location(frame: CanFrame, bit: int) -> int:
    """Return in which field of a frame a bit lies, CAN_ERR_PROT_LOC_*.

    Args:
        frame: what was sent.
        bit: position on the wire, stuff bits counted.

    >>> [hex(location(CanFrame(identifier=0x123, data=b"1"), bit)) for bit in (0, 1, 22, 44)]
    ['0x3', '0x2', '0xa', '0x19']
    """
    wire = wire_bits(frame)
    tail: dict[int, int] = {-1: _CRC_DELIMITER, 0: _ACK, 1: _ACK_DELIMITER}
    if bit >= wire.ack_slot - 1:
        return tail.get(bit - wire.ack_slot, _EOF)
    place, run, last = -1, 0, ""
    for each in wire.bits[: bit + 1]:
        if run == 5:
            run = 1  # a stuff bit counts for the next run
        else:
            place, run = place + 1, run + 1 if each == last else 1
        last = each
    middle = ((4, _RES0),) if frame.fd else ((1, _RES1), (1, _RES0)) if frame.extended else ((1, _RES0),)
    head = (*_BASE, (1, _SRTR), (1, _IDE), *_REST, (1, _RTR)) if frame.extended else (*_BASE, (1, _RTR), (1, _IDE))
    fields: tuple[tuple[int, int], ...] = (*head, *middle, (4, _DLC), (8 * len(frame.data), _DATA))
    for size, field in fields:
        if place < size:
            return field
        place -= size
    return _CRC


def destroyed(frame: CanFrame, bit: int, *, sender: bool) -> ErrorFrame:
    """Return what a node says of a frame that was destroyed.

    Args:
        frame: what was sent.
        bit: the first bit that was seen otherwise.
        sender: whether the node sent it; a receiver says where, but not what.

    >>> error = destroyed(CanFrame(identifier=0x123), 36, sender=True)
    >>> hex(error.kind), error.data.hex(" ")
    ('0xa8', '00 00 90 19 00 00 00 00')
    >>> destroyed(CanFrame(identifier=0x123), 36, sender=False).data.hex(" ")
    '00 00 00 19 00 00 00 00'
    """
    where, kind = location(frame, bit), PROTOCOL | BUS_ERROR
    if not sender:
        return ErrorFrame(kind, bytes((0, 0, 0, where, 0, 0, 0, 0)))
    bits = wire_bits(frame)
    recessive = bit == bits.ack_slot or bits.bits[bit] == "1"
    kind |= ACKNOWLEDGE if where == _ACK else 0
    return ErrorFrame(kind, bytes((0, 0, _BY_SENDER | (_BIT1 if recessive else _BIT0), where, 0, 0, 0, 0)))


def changed(before: State, state: State, tec: int, rec: int) -> ErrorFrame:
    """Return what a node says when its error state has changed.

    Args:
        before, state: its states.
        tec, rec: its counters.

    >>> [hex(changed("warning", "passive", *counters).data[1]) for counters in ((128, 0), (0, 130))]
    ['0x20', '0x10']
    """
    counters = bytes((min(tec, 255), min(rec, 255)))
    if state == "off":
        return ErrorFrame(BUS_OFF, bytes(6) + counters)
    transmit, receive = ((level >= WARNING) + (level >= PASSIVE) for level in (tec, rec))
    said = (_TRANSMIT[transmit] if transmit >= receive else 0) | (_RECEIVE[receive] if receive >= transmit else 0)
    return ErrorFrame(CONTROLLER | (RESTARTED if before == "off" else 0), bytes((0, said or _ACTIVE, 0, 0, 0, 0)) + counters)


def status(kind: int, data: bytes) -> BusStatus | None:
    """Return the state that an error frame says its controller has reached, None where it says none.

    Args:
        kind: its error classes.
        data: its bytes.

    >>> status(CONTROLLER, bytes((0, 0x20, 0, 0, 0, 0, 128, 0)))
    BusStatus(state='passive', tec=128, rec=0)
    """
    if len(data) < 8 or not kind & (BUS_OFF | CONTROLLER | RESTARTED):
        return None
    said = data[1]
    levels: tuple[tuple[int, State], ...] = ((0x30, "passive"), (0x0C, "warning"), (_ACTIVE, "active"))
    known: State | None = "off" if kind & BUS_OFF else next((state for bits, state in levels if said & bits), None)
    if known is None:
        return BusStatus("active", data[6], data[7]) if kind & RESTARTED else None
    return BusStatus(known, data[6], data[7])
