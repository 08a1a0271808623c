"""Version 2 of the wire format: several sensor nodes, the reference, and a nonce that the answer echoes.

====== ====== ============================================== ===================================================
offset type   sensor packet                                  control packet (send-all)
====== ====== ============================================== ===================================================
0      u16    CRC of every byte from offset 2                CRC of every byte from offset 2
2      u8     0x21 (version 2, kind 1)                       0x22 (version 2, kind 2)
3      u8     bit 7 EMPTY, bit 6 MORE, bits 0-5 outputs      bit 7 TAGGED, bits 0-6 selection code
4      u32    seq: slot k                                    seq: slot k that is answered
8      u64    nonce of session and slot                      the nonce of the question
16     i64    sample_ns: nominal time of the newest sample   sample_ns: of the newest sample that was used
24     u8     node: number of the sensor node                i64 control_ns: when the rows were computed
25     u8     samples, newest first
26     u8     bit 7 TAGGED, bits 0-6 references
27     u8     nodes: sensor nodes of the rig
28     f32[]  outputs x samples values, sample after sample
32            (then) one f32 per reference, of slot k        i16 tau in samples, -1 for none
34                                                           u8 number of rows, then u8 inputs per row
36                                                           f32[] rows, row after row
====== ====== ============================================== ===================================================

Where TAGGED is set, 12 bytes follow the last value: u32 freshness, a counter that only grows within a session, and the first
8 bytes of a message authentication code over every byte from offset 2 to the freshness, this included. Who has no key reads
over them. The motor's sensor packet has 48 bytes, its control packet 48, with a tag 48 and 64: each one CAN FD frame. Larger
ones travel in several frames, up to 4096 bytes.

An EMPTY packet has no sample, and its outputs and samples are 0; it carries the reference all the same.
"""

from __future__ import annotations

from functools import lru_cache
from struct import Struct
from typing import Final

from transport.errors import FieldError
from transport.wire.fields import MAX_OUTPUTS, SELECTIONS, ControlPacket, Layout, SensorPacket, frame_length, single

SENSOR: Final = 0x21
CONTROL: Final = 0x22

MAX_VALUES: Final = 1000
"""Values in one packet, references included: what 64 CAN FD frames hold."""

MAX_REFERENCES: Final = 127
TAG_BYTES: Final = 8
_TAGGED: Final = 0x80
_TRAILER: Final = Struct("<I8s")


@lru_cache(maxsize=1024)  # bounded: shapes may come from the wire
def _sensor_layout(values: int, tagged: bool) -> Layout:
    used = 28 + 4 * values + 12 * tagged
    size = frame_length(used)
    body = f"{values}f{'I8s' * tagged}{size - used}x"
    return Layout(Struct(f"<BBIQqBBBB{body}"), Struct(f"<4xIQqB3x{body}"), size)


@lru_cache(maxsize=1024)
def _control_layout(values: int, tagged: bool) -> Layout:
    used = 36 + 4 * values + 12 * tagged
    size = frame_length(used)
    body = f"{values}f{'I8s' * tagged}{size - used}x"
    return Layout(Struct(f"<BBIQqqhBB{body}"), Struct(f"<4xIQqqh2x{body}"), size)


@lru_cache(maxsize=1024)
def _sensor_shape(y: int, empty: bool, samples: int, references: int, node: int, nodes: int) -> tuple[int, int]:
    """Outputs and samples of a packet; one that cannot be written is refused once and for all."""
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
    return outputs, samples


def _trailer(freshness: int, tag: bytes) -> tuple[int, bytes]:
    if len(tag) != TAG_BYTES:
        raise FieldError("tag", f"{len(tag)} bytes, expected {TAG_BYTES}")
    return freshness & 0xFFFFFFFF, tag


def write_sensor(packet: SensorPacket) -> bytes:
    """Bytes behind the CRC of a sensor packet of version 2."""
    seq, flags, sample_ns, y, node, samples, reference, nodes, nonce, freshness, tag, _ = packet
    outputs, samples = _sensor_shape(len(y), bool(flags & 2), samples, len(reference), node, nodes)
    references = len(reference)
    values: tuple[float | bytes, ...] = y + reference
    if tag:
        values += _trailer(freshness, tag)
        references |= _TAGGED
    write = _sensor_layout(len(y) + len(reference), bool(tag)).write.pack
    head = (SENSOR, (flags & 3) << 6 | outputs, seq & 0xFFFFFFFF, nonce, sample_ns, node, samples, references, nodes)
    try:
        return write(*head, *values)
    except OverflowError:
        return write(*head, *map(single, y + reference), *values[len(y) + len(reference) :])


def write_control(packet: ControlPacket, tau: int, inputs: int, values: tuple[float, ...]) -> bytes:
    """Bytes behind the CRC of a control packet of version 2; tau, inputs and values as `transport.packets` checked them."""
    if len(values) > MAX_VALUES:
        raise FieldError("rows", f"{len(values)} values, expected up to {MAX_VALUES}")
    tag = packet.tag
    trailer = _trailer(packet.freshness, tag) if tag else ()
    selection = _TAGGED | packet.selection if tag else packet.selection
    head = (
        CONTROL, selection, packet.seq & 0xFFFFFFFF, packet.nonce, packet.sample_ns, packet.control_ns, tau, len(packet.rows),
        inputs,
    )  # fmt: skip
    write = _control_layout(len(values), bool(tag)).write.pack
    try:
        return write(*head, *values, *trailer)
    except OverflowError:
        return write(*head, *map(single, values), *trailer)


def sensor_size(data: bytes) -> int | None:
    """Length of the sensor packet that begins with these bytes; 0 if it would be too long, None if more are needed to tell."""
    if len(data) < 28:
        return None
    values = (data[3] & 0x3F) * data[25] + (data[26] & 0x7F)
    return _sensor_layout(values, data[26] >= _TAGGED).size if values <= MAX_VALUES else 0


def control_size(data: bytes) -> int | None:
    """Length of the control packet that begins with these bytes; 0 if it would be too long, None if more are needed to tell."""
    if len(data) < 36:
        return None
    values = data[34] * data[35]
    return _control_layout(values, data[3] >= _TAGGED).size if values <= MAX_VALUES else 0


def read_sensor(data: bytes) -> SensorPacket | None:
    """The sensor packet in bytes of the right length and CRC."""
    shape, samples, references, nodes = data[3], data[25], data[26] & 0x7F, data[27]
    outputs, tagged = shape & 0x3F, data[26] >= _TAGGED
    count = outputs * samples
    if (count == 0) != (shape >> 7) or (outputs == 0) != (samples == 0):
        return None
    fields = _sensor_layout(count + references, tagged).read.unpack(data)
    seq, nonce, sample_ns, node = fields[:4]
    if node >= nodes:
        return None
    freshness, tag = fields[-2:] if tagged else (0, b"")
    y, reference = fields[4 : 4 + count], fields[4 + count : 4 + count + references]
    return SensorPacket(seq, shape >> 6, sample_ns, y, node, samples or 1, reference, nodes, nonce, freshness, tag, 2)


def read_control(data: bytes) -> ControlPacket | None:
    """The control packet in bytes of the right length and CRC."""
    selection, tagged, count, inputs = data[3] & 0x7F, data[3] >= _TAGGED, data[34], data[35]
    if selection >= len(SELECTIONS) or (count == 0) != (inputs == 0):
        return None
    size = count * inputs
    fields = _control_layout(size, tagged).read.unpack(data)
    seq, nonce, sample_ns, control_ns, tau = fields[:5]
    freshness, tag = fields[-2:] if tagged else (0, b"")
    rows = tuple([fields[i : i + inputs] for i in range(5, 5 + size, inputs or 1)])
    return ControlPacket(seq, sample_ns, control_ns, tau, selection, rows, nonce, freshness, tag, 2)


def sensor_length(values: int) -> int:
    """Bytes of a sensor packet without a tag that holds so many values, references included.

    >>> sensor_length(1 + 1), sensor_length(3 + 4)
    (48, 64)
    """
    return _sensor_layout(values, False).size
