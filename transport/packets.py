"""Sensor and send-all control packets: the bytes that travel, and the decoder that believes nobody.

Little endian, naturally aligned, and always as long as a legal CAN FD frame (0-8, 12, 16, 20, 24, 32, 48, 64 bytes,
above that a multiple of 8), so that no bus adds padding of its own. Unused bytes at the end are zero.

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

The CRC is CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, "123456789" gives 0x29B1), padding included.
A packet of one measurement has 20 bytes, the payload of the thesis's (7.35) as four 4-byte IEEE 754 values makes a
control packet of 48 bytes: each one CAN FD frame.

Reference: thesis chapter 7, (7.9)-(7.13) for the rows, (7.35) for the packet.
"""

from __future__ import annotations

from binascii import crc_hqx
from functools import cache, lru_cache
from math import copysign, inf
from struct import Struct
from typing import Final, NamedTuple

MORE: Final = 1
"""Sensor flag: further frames of the same slot follow."""
EMPTY: Final = 2
"""Sensor flag: nothing arrived in this slot, the packet carries no measurement."""

SELECTIONS: Final = ("constant", "generated", "applied", "previous", "both")
"""How the actuator picks a row; the wire code is the index."""

MAX_OUTPUTS: Final = 63
MAX_ROWS: Final = 255
MAX_INPUTS: Final = 255
TAU_LIMIT: Final = 32767
"""Larger ages are sent as this one."""

FD_LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""The payload lengths that a CAN FD frame can have."""
_LENGTHS: Final = tuple(next(length for length in FD_LENGTHS if length >= size) for size in range(65))

_SENSOR: Final = 0x11
_CONTROL: Final = 0x12
_CRC_START: Final = 0xFFFF


class SensorPacket(NamedTuple):
    """One measurement on its way to the controller.

    Attributes:
        seq: slot k in which the frame is sent (u32, wraps).
        flags: sum of ``MORE`` and ``EMPTY``.
        sample_ns: nominal session time of the sample, ns.
        y: measurement, shape (p,), float32 on the wire; empty if and only if ``EMPTY`` is set.
    """

    seq: int
    flags: int
    sample_ns: int
    y: tuple[float, ...]


class ControlPacket(NamedTuple):
    """One row of inputs for every delay the actuator may find: *send all, apply one*.

    Attributes:
        seq: slot k that is answered (u32, wraps).
        sample_ns: nominal session time of the newest sample used, ns.
        control_ns: session time at which the rows were computed, ns.
        tau: measured sensor-to-controller delay in samples, -1 while there is no sample; saturates at ``TAU_LIMIT``.
        selection: index into ``SELECTIONS``.
        rows: inputs, shape (rows, m), float32 on the wire.
    """

    seq: int
    sample_ns: int
    control_ns: int
    tau: int
    selection: int
    rows: tuple[tuple[float, ...], ...]


class _Layout(NamedTuple):
    """One packet shape: writer and reader without CRC, and the length on the wire."""

    write: Struct
    read: Struct
    size: int


@lru_cache(maxsize=1024)
def frame_length(size: int) -> int:
    """Shortest length of a CAN FD frame, or multiple of 8 above 64, that holds ``size`` bytes.

    >>> [frame_length(n) for n in (0, 8, 9, 20, 44, 64, 65)]
    [0, 8, 12, 20, 48, 64, 72]
    """
    return _LENGTHS[size] if size <= 64 else -(-size // 8) * 8


@cache
def _sensor_layout(count: int) -> _Layout:
    size = frame_length(16 + 4 * count)
    pad = f"{size - 16 - 4 * count}x"
    return _Layout(Struct(f"<BBIq{count}f{pad}"), Struct(f"<4xIq{count}f{pad}"), size)


@lru_cache(maxsize=1024)  # bounded: shapes may come from the wire
def _control_layout(values: int) -> _Layout:
    size = frame_length(28 + 4 * values)
    pad = f"{size - 28 - 4 * values}x"
    return _Layout(Struct(f"<BBIqqhBB{values}f{pad}"), Struct(f"<4xIqqh2x{values}f{pad}"), size)


def _single(value: float) -> float:
    """A number that float32 can hold: what is too large becomes an infinity, as in a conversion by hardware."""
    value = float(value)
    return value if abs(value) < 3.4028235e38 or value != value else copysign(inf, value)


def encode_sensor(packet: SensorPacket) -> bytes:
    """Bytes of a sensor packet.

    Args:
        packet: measurement of p <= 63 values, or none together with the flag ``EMPTY``.

    Returns:
        20 bytes for p = 1; see the module for the layout. Values beyond float32 become infinities.

    Raises:
        ValueError: the flag ``EMPTY`` contradicts ``y``, or there are more than 63 values.

    >>> encode_sensor(SensorPacket(seq=7, flags=0, sample_ns=350_000_000, y=(3.0,))).hex(" ", 4)
    '0b5e1101 07000000 8093dc14 00000000 00004040'
    """
    seq, flags, sample_ns, y = packet
    count = len(y)
    if count > MAX_OUTPUTS or (count == 0) != (flags >> 1 & 1):
        raise ValueError(f"y: {count} values with flags {flags}, expected 1 to {MAX_OUTPUTS}, or none and EMPTY")
    head = (_SENSOR, (flags & 3) << 6 | count, seq & 0xFFFFFFFF, sample_ns)
    write = _sensor_layout(count).write.pack
    try:
        body = write(*head, *y)
    except OverflowError:
        body = write(*head, *map(_single, y))
    return crc_hqx(body, _CRC_START).to_bytes(2, "little") + body


def encode_control(packet: ControlPacket) -> bytes:
    """Bytes of a send-all control packet.

    Args:
        packet: rows of shape (rows, m), all of one length.

    Returns:
        32 bytes for one value, 48 for up to 5, 64 for up to 9. Values beyond float32 become infinities.

    Raises:
        ValueError: rows of different length or none, more than 255 of them, or an unknown selection code.

    >>> packet = ControlPacket(seq=7, sample_ns=0, control_ns=1, tau=1, selection=1, rows=((1.0, 2.0), (3.0, 4.0)))
    >>> len(encode_control(packet)), decode(encode_control(packet)) == packet
    (48, True)
    """
    seq, sample_ns, control_ns, tau, selection, rows = packet
    count = len(rows)
    inputs = len(rows[0]) if count else 0
    values = rows[0] if count == 1 else tuple([value for row in rows for value in row])
    if count > MAX_ROWS or (count and not 0 < inputs <= MAX_INPUTS) or {*map(len, rows)} - {inputs}:
        raise ValueError(f"rows: lengths {[*map(len, rows)]}, expected up to 255 rows of one length, 1 to 255")
    if not 0 <= selection < len(SELECTIONS):
        raise ValueError(f"selection: {selection}, expected a code from 0 to {len(SELECTIONS) - 1}")
    if not -1 <= tau <= TAU_LIMIT:
        tau = -1 if tau < 0 else TAU_LIMIT
    head = (_CONTROL, selection, seq & 0xFFFFFFFF, sample_ns, control_ns, tau, count, inputs)
    write = _control_layout(count * inputs).write.pack
    try:
        body = write(*head, *values)
    except OverflowError:
        body = write(*head, *map(_single, values))
    return crc_hqx(body, _CRC_START).to_bytes(2, "little") + body


def packet_size(data: bytes) -> int | None:
    """Length of the packet that begins with these bytes: 0 if none does, None if more bytes are needed to tell.

    Args:
        data: any bytes, such as the fragments of a packet that have come so far.

    >>> packet_size(b"..."), packet_size(b"...."), packet_size(bytes((0, 0, 0x11, 1)))
    (None, 0, 20)
    """
    if len(data) < 4:
        return None
    if data[2] == _SENSOR:
        return _sensor_layout(data[3] & 0x3F).size
    if data[2] != _CONTROL:
        return 0
    return frame_length(28 + 4 * data[26] * data[27]) if len(data) >= 28 else None


def decode(data: bytes) -> SensorPacket | ControlPacket | None:
    """The packet in ``data``, or None if it is malformed in any way; never raises, whatever the bytes.

    Up to 7 zero bytes behind the packet are taken as padding of a classic CAN frame. Every flip of a single bit is
    found: where it leaves the length as it was, by the CRC; a changed length differs by 8 or more and does not fit.

    Args:
        data: one received frame, any length and content.

    >>> decode(bytes(20)) is None
    True
    """
    size = packet_size(data)
    if not size or len(data) < size:
        return None
    if len(data) != size:
        if len(data) - size > 7 or any(data[size:]):
            return None
        data = data[:size]
    if crc_hqx(data[2:], _CRC_START) != data[0] | data[1] << 8:
        return None
    if data[2] == _SENSOR:
        shape = data[3]
        count = shape & 0x3F
        if (count == 0) != (shape >> 7):
            return None
        fields = _sensor_layout(count).read.unpack(data)
        return SensorPacket(fields[0], shape >> 6, fields[1], fields[2:])
    selection, count, inputs = data[3], data[26], data[27]
    if selection >= len(SELECTIONS) or (count == 0) != (inputs == 0):
        return None
    fields = _control_layout(count * inputs).read.unpack(data)
    values = fields[4:]
    rows = (values,) if count == 1 else tuple([values[i : i + inputs] for i in range(0, len(values), inputs or 1)])
    return ControlPacket(fields[0], fields[1], fields[2], fields[3], selection, rows)
