"""Version 1 of the wire format: one sensor node, no nonce; accepted where the link says ``?version=1``.

====== ====== ======================================== ======================================================
offset type   sensor packet                            control packet (send-all)
====== ====== ======================================== ======================================================
0      u16    CRC of every byte from offset 2          CRC of every byte from offset 2
2      u8     0x11 (version 1, kind 1)                 0x12 (version 1, kind 2)
3      u8     bit 7 EMPTY, bit 6 MORE, bits 0-5 count  selection code, index into ``SELECTIONS``
4      u32    seq: slot k                              seq: slot k that is answered
8      i64    sample_ns: nominal time of the sample    sample_ns: of the newest sample that was used
16     f32[]  y, ``count`` values                      i64 control_ns: when the rows were computed
24                                                     i16 tau in samples, -1 for none
26                                                     u8 number of rows, then u8 inputs per row
28                                                     f32[] rows, row after row
====== ====== ======================================== ======================================================

A packet of one measurement has 20 bytes, the payload of the thesis's (7.35) as four 4-byte IEEE 754 values makes a
control packet of 48 bytes: each one CAN FD frame.
"""

from __future__ import annotations

from functools import cache, lru_cache
from itertools import chain
from struct import Struct
from typing import Final

from transport.errors import FieldError
from transport.wire.fields import (
    MAX_OUTPUTS,
    SELECTIONS,
    ControlPacket,
    Layout,
    Reader,
    SensorPacket,
    check_control,
    frame_length,
    single,
)

SENSOR: Final = 0x11
CONTROL: Final = 0x12
_flat: Final = chain.from_iterable


@cache
def _sensor_layout(count: int) -> Layout:
    size = frame_length(16 + 4 * count)
    pad = f"{size - 16 - 4 * count}x"
    return Layout(Struct(f"<BBIq{count}f{pad}"), Struct(f"<4xIq{count}f{pad}"), size)


@lru_cache(maxsize=1024)  # bounded: shapes may come from the wire
def _control_layout(values: int) -> Layout:
    size = frame_length(28 + 4 * values)
    pad = f"{size - 28 - 4 * values}x"
    return Layout(Struct(f"<BBIqqhBB{values}f{pad}"), Struct(f"<4xIqqh2x{values}f{pad}"), size)


def write_sensor(packet: SensorPacket) -> bytes:
    """Bytes behind the CRC of a sensor packet of version 1."""
    y, flags = packet.y, packet.flags
    count = len(y)
    if count > MAX_OUTPUTS or (count == 0) != (flags >> 1 & 1):
        raise FieldError("y", f"{count} values with flags {flags}, expected 1 to {MAX_OUTPUTS}, or none and EMPTY")
    if packet.node or packet.nodes != 1:
        raise FieldError("node", f"{packet.node} of {packet.nodes}, wire version 1 knows one sensor node")
    head = (SENSOR, (flags & 3) << 6 | count, packet.seq & 0xFFFFFFFF, packet.sample_ns)
    write = _sensor_layout(count).write.pack
    try:
        return write(*head, *y)
    except OverflowError:
        return write(*head, *map(single, y))


def write_control(packet: ControlPacket, tau: int, inputs: int) -> bytes:
    """Bytes behind the CRC of a control packet of version 1; tau in its range, and so many inputs in every row."""
    rows, selection = packet.rows, packet.selection
    check_control(len(rows), inputs, selection)
    head = (CONTROL, selection, packet.seq & 0xFFFFFFFF, packet.sample_ns, packet.control_ns, tau, len(rows), inputs)
    write = _control_layout(len(rows) * inputs).write.pack
    try:
        return write(*head, *_flat(rows))
    except OverflowError:
        return write(*head, *map(single, _flat(rows)))


def sensor_reader(data: bytes) -> Reader[SensorPacket]:
    """Length and reader of the sensor packet that begins with these bytes, at least 4."""
    return _sensor_layout(data[3] & 0x3F).size, _read_sensor


def control_reader(data: bytes) -> Reader[ControlPacket] | None:
    """Length and reader of the control packet that begins with these bytes; None if more are needed to tell."""
    return (frame_length(28 + 4 * data[26] * data[27]), _read_control) if len(data) >= 28 else None


def _read_sensor(data: bytes) -> SensorPacket | None:
    shape = data[3]
    count = shape & 0x3F
    if (count == 0) != (shape >> 7):
        return None
    fields = _sensor_layout(count).read.unpack(data)
    return SensorPacket(fields[0], shape >> 6, fields[1], fields[2:])


def _read_control(data: bytes) -> ControlPacket | None:
    selection, count, inputs = data[3], data[26], data[27]
    if selection >= len(SELECTIONS) or (count == 0) != (inputs == 0):
        return None
    fields = _control_layout(count * inputs).read.unpack(data)
    values = fields[4:]
    rows = (values,) if count == 1 else tuple([values[i : i + inputs] for i in range(0, len(values), inputs or 1)])
    return ControlPacket(fields[0], fields[1], fields[2], fields[3], selection, rows)
