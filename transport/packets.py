"""Sensor and send-all control packets: the bytes that travel, and the decoder that checks every field.

Little endian, naturally aligned, and always as long as a legal CAN FD frame (0-8, 12, 16, 20, 24, 32, 48, 64 bytes,
above that a multiple of 8), so that no bus adds padding of its own. Unused bytes at the end are zero.

Byte 2 says version (upper four bits) and kind (lower four: 1 sensor, 2 control); :mod:`transport.wire.layout` says the rest. The
CRC is CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, "123456789" gives 0x29B1), padding included.

Reference: thesis chapter 7, (7.9)-(7.13) for the rows, (7.35) for the packet.
"""

from __future__ import annotations

from binascii import crc_hqx

from transport.errors import FieldError
from transport.wire import layout
from transport.wire.fields import (
    CRC_START,
    EMPTY,
    FD_LENGTHS,
    MAX_INPUTS,
    MAX_OUTPUTS,
    MAX_ROWS,
    MORE,
    SELECTIONS,
    TAU_LIMIT,
    ControlPacket,
    SensorPacket,
    frame_length,
)
from transport.wire.layout import MAX_VALUES

__all__ = [
    "EMPTY", "FD_LENGTHS", "MAX_INPUTS", "MAX_OUTPUTS", "MAX_ROWS", "MAX_VALUES", "MORE", "SELECTIONS", "TAU_LIMIT",
    "ControlPacket", "SensorPacket", "decode", "encode_control", "encode_sensor", "frame_length", "node_of",
    "packet_size",
]  # fmt: skip


def encode_sensor(packet: SensorPacket) -> bytes:
    """Bytes of a sensor packet.

    Args:
        packet: measurements of p <= 63 outputs, or none together with the flag ``EMPTY``.

    Returns:
        36 bytes and 4 for each value, rounded up to a length that a frame can have. Values beyond float32 become infinities.

    Raises:
        ValueError: the flag ``EMPTY`` contradicts ``y``, or there are too many values or nodes.

    >>> encode_sensor(SensorPacket(seq=7, flags=0, sample_ns=350_000_000, y=(3.0,), counter=8))[2:36].hex(" ", 4)
    '3101 07000000 00000000 00000000 8093dc14 00000000 00010001 08000000 00004040'
    """
    body = layout.write_sensor(packet)
    return crc_hqx(body, CRC_START).to_bytes(2, "little") + body


def encode_control(packet: ControlPacket) -> bytes:
    """Bytes of a send-all control packet.

    Args:
        packet: rows of shape (rows, m), all of one length.

    Returns:
        48 bytes for up to 2 values, 64 for up to 6.
        Values beyond float32 become infinities.

    Raises:
        ValueError: rows of different length or none, more than 255 of them, or an unknown selection code.

    >>> packet = ControlPacket(seq=7, sample_ns=0, control_ns=1, tau=1, selection=1, rows=((1.0, 2.0), (3.0, 4.0)))
    >>> len(encode_control(packet)), decode(encode_control(packet)) == packet
    (64, True)
    """
    rows, tau = packet.rows, packet.tau
    inputs = len(rows[0]) if rows else 0
    for row in rows:
        if len(row) != inputs:
            raise FieldError("rows", f"lengths {[*map(len, rows)]}, expected one length")
    if not -1 <= tau <= TAU_LIMIT:
        tau = -1 if tau < 0 else TAU_LIMIT
    body = layout.write_control(packet, tau, inputs)
    return crc_hqx(body, CRC_START).to_bytes(2, "little") + body


def packet_size(data: bytes) -> int | None:
    """Length of the packet that begins with these bytes: 0 if none does, None if more bytes are needed to tell.

    Args:
        data: any bytes, such as the fragments of a packet that have come so far.

    >>> packet_size(b"..."), packet_size(b"...."), packet_size(bytes((0, 0, 0x31)) + bytes(29))
    (None, 0, 32)
    """
    if len(data) < 4:
        return None
    return layout.length_of(data)


def node_of(data: bytes) -> int:
    """Number of the sensor node that a packet names, nothing of it judged; 0 where it names none.

    Args:
        data: any bytes, such as a packet or its first 25 bytes.

    >>> node_of(bytes((0, 0, 0x31)) + bytes(21) + bytes((3,))), node_of(b"...")
    (3, 0)
    """
    return data[24] if len(data) > 24 and data[2] == layout.SENSOR else 0


def decode(data: bytes) -> SensorPacket | ControlPacket | None:
    """The packet in ``data``, or None if it is malformed in any way; never raises, whatever the bytes.

    Up to 7 zero bytes behind the packet are taken as padding of a classic CAN frame. Every flip of a single bit is
    found: where it leaves the length as it was, by the CRC; a changed length differs by 8 or more and does not fit.

    Args:
        data: one received frame, any length and content.

    >>> decode(bytes(20)) is None
    True
    """
    length = len(data)
    kind = layout.KINDS.get(data[2]) if length >= 4 else None
    if kind is None:
        return None
    least, shape_of, reader_of = kind
    if length < least:
        return None
    size, read = reader_of(*shape_of(data))
    if length != size:
        if not size or not 0 < length - size <= 7 or any(data[size:]):
            return None
        data = data[:size]
    if crc_hqx(data[2:], CRC_START) != data[0] | data[1] << 8:
        return None
    return read(data)
