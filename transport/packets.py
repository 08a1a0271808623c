"""Sensor and send-all control packets: the bytes that travel, and the decoder that checks every field.

Little endian, naturally aligned, and always as long as a legal CAN FD frame (0-8, 12, 16, 20, 24, 32, 48, 64 bytes,
above that a multiple of 8), so that no bus adds padding of its own. Unused bytes at the end are zero. :mod:`transport.wire` says
what stands where.

Reference: thesis chapter 7, (7.9)-(7.13) for the rows, (7.35) for the packet.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable
from functools import lru_cache
from itertools import chain
from math import copysign, inf
from operator import itemgetter
from typing import Any, Final, TypeAlias, TypeVar

from transport.errors import FieldError
from transport.wire import (
    CONTROL,
    CONTROL_BYTES,
    CRC_START,
    EMPTY,
    FD_LENGTHS,
    MAX_INPUTS,
    MAX_OUTPUTS,
    MAX_ROWS,
    MAX_VALUES,
    MORE,
    SELECTIONS,
    SENSOR,
    SENSOR_BYTES,
    TAGGED,
    TAU_LIMIT,
    ControlPacket,
    SensorPacket,
    frame_length,
    layout,
)

__all__ = [
    "EMPTY", "FD_LENGTHS", "MAX_INPUTS", "MAX_OUTPUTS", "MAX_ROWS", "MAX_VALUES", "MORE", "SELECTIONS", "TAU_LIMIT",
    "ControlPacket", "SensorPacket", "decode", "encode_control", "encode_sensor", "frame_length", "node_of", "packet_size",
]  # fmt: skip

MAX_REFERENCES: Final = 127
_flat: Final = chain.from_iterable
_new: Final = tuple.__new__  # without the Python constructor: in five files 6 % of an interpreted virtual slot

Packet = TypeVar("Packet", SensorPacket, ControlPacket)
Reader: TypeAlias = tuple[int, Callable[[bytes], Packet | None]]
"""Length of a packet, and what reads its bytes."""


@lru_cache(maxsize=1024)
def _sensor_writer(
    y: int, flags: int, samples: int, references: int, node: int, nodes: int
) -> tuple[Callable[..., bytes], int, int]:
    """How a packet is packed, its bytes 3 and 25; one that cannot be written is refused."""
    empty = bool(flags & 2)
    samples = 0 if empty else samples
    outputs = y // samples if samples else 0
    if (not y) != empty or outputs * samples != y or outputs > MAX_OUTPUTS or not 0 <= samples <= 255:
        raise FieldError(
            "y",
            f"{y} values in {samples} samples, {'EMPTY' if empty else 'not EMPTY'}; expected up to 255 samples of 1 to "
            f"{MAX_OUTPUTS} outputs, or none and EMPTY",
        )
    if references > MAX_REFERENCES or y + references > MAX_VALUES:
        raise FieldError("reference", f"{references} values beside {y}, expected up to {MAX_REFERENCES}, and {MAX_VALUES} in all")
    if not 0 <= node < nodes <= 255:
        raise FieldError("node", f"{node} of {nodes}, expected up to 255 nodes, numbered from 0")
    return layout(SENSOR, y + references, False).write.pack, flags << 6 | outputs, samples


@lru_cache(maxsize=1024)
def _control_writer(count: int, inputs: int, selection: int) -> Callable[..., bytes]:
    """How a packet is packed; one that cannot be written is refused."""
    if count > MAX_ROWS or (count and not 0 < inputs <= MAX_INPUTS):
        raise FieldError("rows", f"{count} rows of {inputs}, expected up to {MAX_ROWS} rows of 1 to {MAX_INPUTS}")
    if not 0 <= selection < len(SELECTIONS):
        raise FieldError("selection", f"{selection}, expected a code from 0 to {len(SELECTIONS) - 1}")
    if count * inputs > MAX_VALUES:
        raise FieldError("rows", f"{count * inputs} values, expected up to {MAX_VALUES}")
    pack: Callable[..., bytes] = layout(CONTROL, count * inputs, False).write.pack
    return pack


def _single(value: float) -> float:
    """A number that float32 can hold: what is too large becomes an infinity, as in a conversion by hardware."""
    value = float(value)
    return value if abs(value) < 3.4028235e38 or value != value else copysign(inf, value)


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
    seq, flags, sample_ns, y, node, samples, reference, nodes, nonce, counter = packet
    references = len(reference)
    pack, shape, samples = _sensor_writer(len(y), flags & 3, samples, references, node, nodes)
    seq, counter = seq & 0xFFFFFFFF, counter & 0xFFFFFFFF
    try:
        body = pack(SENSOR, shape, seq, nonce, sample_ns, node, samples, references, nodes, counter, *y, *reference)
    except OverflowError:
        values = map(_single, (*y, *reference))
        body = pack(SENSOR, shape, seq, nonce, sample_ns, node, samples, references, nodes, counter, *values)
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
    seq, sample_ns, control_ns, tau, selection, rows, echo, counter = packet
    count, inputs = len(rows), len(rows[0]) if rows else 0
    for row in rows:
        if len(row) != inputs:
            raise FieldError("rows", f"lengths {[*map(len, rows)]}, expected one length")
    if not -1 <= tau <= TAU_LIMIT:
        tau = -1 if tau < 0 else TAU_LIMIT
    pack = _control_writer(count, inputs, selection)
    seq, counter = seq & 0xFFFFFFFF, counter & 0xFFFFFFFF
    try:
        body = pack(CONTROL, selection, seq, echo, sample_ns, control_ns, tau, count, inputs, counter, *_flat(rows))
    except OverflowError:
        values = map(_single, _flat(rows))
        body = pack(CONTROL, selection, seq, echo, sample_ns, control_ns, tau, count, inputs, counter, *values)
    return crc_hqx(body, CRC_START).to_bytes(2, "little") + body


@lru_cache(maxsize=1024)
def _sensor_reader(shape: int, samples: int, references: int, nodes: int) -> Reader[SensorPacket]:
    """Length and reader of the sensor packets with these bytes 3, 25, 26 and 27."""
    outputs, tagged = shape & 0x3F, references >= TAGGED
    count, flags = outputs * samples, shape >> 6
    values = count + (references & 0x7F)
    if values > MAX_VALUES:
        return 0, _nothing
    found = layout(SENSOR, values, tagged)
    if (count == 0) != (flags >> 1) or (outputs == 0) != (samples == 0):
        return found.size, _nothing
    unpack, samples, after, end = found.read.unpack, samples or 1, 5 + count, 5 + values

    def read(data: bytes) -> SensorPacket | None:
        fields = unpack(data)  # seq, nonce, sample_ns, node, counter, values
        node = fields[3]
        if node >= nodes:
            return None
        y, reference = fields[5:after], fields[after:end]
        said = (fields[0], flags, fields[2], y, node, samples, reference, nodes, fields[1], fields[4])
        return _new(SensorPacket, said)

    return found.size, read


@lru_cache(maxsize=1024)
def _control_reader(shape: int, count: int, inputs: int) -> Reader[ControlPacket]:
    """Length and reader of the control packets with these bytes 3, 34 and 35."""
    selection, tagged, size = shape & 0x7F, shape >= TAGGED, count * inputs
    if size > MAX_VALUES:
        return 0, _nothing
    found = layout(CONTROL, size, tagged)
    if selection >= len(SELECTIONS) or (count == 0) != (inputs == 0):
        return found.size, _nothing
    unpack, starts = found.read.unpack, range(6, 6 + size, inputs or 1)

    def read(data: bytes) -> ControlPacket | None:
        fields = unpack(data)  # seq, echo, sample_ns, control_ns, tau, counter, values
        rows = tuple([fields[i : i + inputs] for i in starts])
        said = (fields[0], fields[2], fields[3], fields[4], selection, rows, fields[1], fields[5])
        return _new(ControlPacket, said)

    return found.size, read


def _nothing(data: bytes) -> None:
    """Read a packet of a shape that no packet has."""


_KINDS: Final[dict[int, tuple[int, Callable[[bytes], tuple[int, ...]], Callable[..., Reader[Any]]]]] = {
    SENSOR: (SENSOR_BYTES, itemgetter(3, 25, 26, 27), _sensor_reader),
    CONTROL: (CONTROL_BYTES, itemgetter(3, 34, 35), _control_reader),
}
"""Of each kind of packet, by byte 2: how many bytes say its shape, which ones, and what returns for these its length (0 if too
long) and its reader. The reader takes bytes of that length whose CRC is right."""


def packet_size(data: bytes) -> int | None:
    """Length of the packet that begins with these bytes: 0 if none does or it is too long, None if more are needed to tell.

    Args:
        data: any bytes, such as the fragments of a packet that have come so far.

    >>> packet_size(b"..."), packet_size(b"...."), packet_size(bytes((0, 0, 0x31)) + bytes(29))
    (None, 0, 32)
    """
    known = len(data)
    if known < 4:
        return None
    kind = _KINDS.get(data[2])
    if kind is None:
        return 0
    least, shape_of, reader_of = kind
    return None if known < least else reader_of(*shape_of(data))[0]


def node_of(data: bytes) -> int:
    """Number of the sensor node that a packet names, nothing of it judged; 0 where it names none.

    Args:
        data: any bytes, such as a packet or its first 25 bytes.

    >>> node_of(bytes((0, 0, 0x31)) + bytes(21) + bytes((3,))), node_of(b"...")
    (3, 0)
    """
    return data[24] if len(data) > 24 and data[2] == SENSOR else 0


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
    kind = _KINDS.get(data[2]) if length >= 4 else None
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
