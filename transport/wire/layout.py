"""The bytes of sensor and control packets: version 3 of the wire format.

====== ====== ============================================== ===================================================
offset type   sensor packet                                  control packet (send-all)
====== ====== ============================================== ===================================================
0      u16    CRC of every byte from offset 2                CRC of every byte from offset 2
2      u8     0x31 (version 3, kind 1)                       0x32 (version 3, kind 2)
3      u8     bit 7 EMPTY, bit 6 MORE, bits 0-5 outputs      bit 7 TAGGED, bits 0-6 selection code
4      u32    seq: slot k                                    seq: slot k that is answered
8      u64    nonce of session and slot                      echo: digest of the frames that are answered
16     i64    sample_ns: nominal time of the newest sample   sample_ns: of the newest sample that was used
24     u8     node: number of the sensor node                i64 control_ns: when the rows were computed
25     u8     samples, newest first
26     u8     bit 7 TAGGED, bits 0-6 references
27     u8     nodes: sensor nodes of the rig
28     u32    counter of the frames of this sender
32     f32[]  outputs x samples values, sample after sample; i16 tau in samples, -1 for none
34            then one f32 per reference, of slot k          u8 number of rows, then u8 inputs per row
36                                                           u32 counter of the frames of this sender
40                                                           f32[] rows, row after row
====== ====== ============================================== ===================================================

Both counters grow by one with each frame. They begin with 1 at the hello, and again at slot 0.

Where TAGGED is set, 8 bytes follow the last value: the first ones of a message authentication code over every byte from
offset 2 to the last value. Who has no key reads over them. The motor's sensor packet has 48 bytes, its control packet 48, with
a tag 48 and 64: each one CAN FD frame. Larger ones travel in several frames, up to 4096 bytes.

An EMPTY packet has no sample, and its outputs and samples are 0; it carries the reference all the same.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import chain
from operator import itemgetter
from struct import Struct
from typing import Any, Final

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

SENSOR: Final = 0x31
CONTROL: Final = 0x32
_SENSOR_BYTES: Final = 32  # before the values
_CONTROL_BYTES: Final = 40

MAX_VALUES: Final = 1000
"""Values in one packet, references included: what 64 CAN FD frames hold."""

MAX_REFERENCES: Final = 127
TAG_BYTES: Final = 8
_TAGGED: Final = 0x80
_flat: Final = chain.from_iterable
_new: Final = tuple.__new__  # without the Python constructor: in five files 6 % of an interpreted virtual slot


@lru_cache(maxsize=1024)  # bounded: shapes may come from the wire
def _sensor_layout(values: int, tagged: bool) -> Layout:
    used = _SENSOR_BYTES + 4 * values + TAG_BYTES * tagged
    size = frame_length(used)
    body = f"{values}f{'8s' * tagged}{size - used}x"
    return Layout(Struct(f"<BBIQqBBBBI{body}"), Struct(f"<4xIQqB3xI{body}"), size)


@lru_cache(maxsize=1024)
def _control_layout(values: int, tagged: bool) -> Layout:
    used = _CONTROL_BYTES + 4 * values + TAG_BYTES * tagged
    size = frame_length(used)
    body = f"{values}f{'8s' * tagged}{size - used}x"
    return Layout(Struct(f"<BBIQqqhBBI{body}"), Struct(f"<4xIQqqh2xI{body}"), size)


@lru_cache(maxsize=1024)
def _sensor_writer(
    y: int, flags: int, samples: int, references: int, node: int, nodes: int, tagged: bool
) -> tuple[Callable[..., bytes], int, int, int]:
    """How a packet is packed, its bytes 3, 25 and 26; one that cannot be written is refused."""
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
    pack = _sensor_layout(y + references, tagged).write.pack
    return pack, flags << 6 | outputs, samples, references | _TAGGED if tagged else references


@lru_cache(maxsize=1024)
def _control_writer(count: int, inputs: int, selection: int, tagged: bool) -> tuple[Callable[..., bytes], int]:
    """How a packet is packed, and its byte 3; one that cannot be written is refused."""
    check_control(count, inputs, selection)
    if count * inputs > MAX_VALUES:
        raise FieldError("rows", f"{count * inputs} values, expected up to {MAX_VALUES}")
    return _control_layout(count * inputs, tagged).write.pack, _TAGGED | selection if tagged else selection


def _trailer(tag: bytes) -> tuple[bytes]:
    if len(tag) != TAG_BYTES:
        raise FieldError("tag", f"{len(tag)} bytes, expected {TAG_BYTES}")
    return (tag,)


def write_sensor(packet: SensorPacket) -> bytes:
    """Bytes behind the CRC of a sensor packet."""
    seq, flags, sample_ns, y, node, samples, reference, nodes, nonce, counter, tag = packet
    trailer = _trailer(tag) if tag else ()
    pack, shape, samples, references = _sensor_writer(len(y), flags & 3, samples, len(reference), node, nodes, bool(tag))
    seq, counter = seq & 0xFFFFFFFF, counter & 0xFFFFFFFF
    try:
        return pack(SENSOR, shape, seq, nonce, sample_ns, node, samples, references, nodes, counter, *y, *reference, *trailer)
    except OverflowError:
        values = map(single, (*y, *reference))
        return pack(SENSOR, shape, seq, nonce, sample_ns, node, samples, references, nodes, counter, *values, *trailer)


def write_control(packet: ControlPacket, tau: int, inputs: int) -> bytes:
    """Bytes behind the CRC of a control packet; tau in its range, and so many inputs in every row."""
    seq, sample_ns, control_ns, _, selection, rows, echo, counter, tag = packet
    trailer = _trailer(tag) if tag else ()
    count = len(rows)
    pack, shape = _control_writer(count, inputs, selection, bool(tag))
    seq, counter = seq & 0xFFFFFFFF, counter & 0xFFFFFFFF
    try:
        return pack(CONTROL, shape, seq, echo, sample_ns, control_ns, tau, count, inputs, counter, *_flat(rows), *trailer)
    except OverflowError:
        values = map(single, _flat(rows))
        return pack(CONTROL, shape, seq, echo, sample_ns, control_ns, tau, count, inputs, counter, *values, *trailer)


@lru_cache(maxsize=1024)
def _sensor_reader(shape: int, samples: int, references: int, nodes: int) -> Reader[SensorPacket]:
    """Length and reader of the sensor packets with these bytes 3, 25, 26 and 27."""
    outputs, tagged = shape & 0x3F, references >= _TAGGED
    count, flags = outputs * samples, shape >> 6
    values = count + (references & 0x7F)
    if values > MAX_VALUES:
        return 0, _nothing
    layout = _sensor_layout(values, tagged)
    if (count == 0) != (flags >> 1) or (outputs == 0) != (samples == 0):
        return layout.size, _nothing
    unpack, samples, after, end = layout.read.unpack, samples or 1, 5 + count, 5 + values

    def read(data: bytes) -> SensorPacket | None:
        fields = unpack(data)  # seq, nonce, sample_ns, node, counter, values, the tag
        node = fields[3]
        if node >= nodes:
            return None
        y, reference = fields[5:after], fields[after:end]
        tag = fields[end] if tagged else b""
        said = (fields[0], flags, fields[2], y, node, samples, reference, nodes, fields[1], fields[4], tag)
        return _new(SensorPacket, said)

    return layout.size, read


@lru_cache(maxsize=1024)
def _control_reader(shape: int, count: int, inputs: int) -> Reader[ControlPacket]:
    """Length and reader of the control packets with these bytes 3, 34 and 35."""
    selection, tagged, size = shape & 0x7F, shape >= _TAGGED, count * inputs
    if size > MAX_VALUES:
        return 0, _nothing
    layout = _control_layout(size, tagged)
    if selection >= len(SELECTIONS) or (count == 0) != (inputs == 0):
        return layout.size, _nothing
    unpack, end, starts = layout.read.unpack, 6 + size, range(6, 6 + size, inputs or 1)

    def read(data: bytes) -> ControlPacket | None:
        fields = unpack(data)  # seq, echo, sample_ns, control_ns, tau, counter, values, the tag
        rows = tuple([fields[i : i + inputs] for i in starts])
        tag = fields[end] if tagged else b""
        said = (fields[0], fields[2], fields[3], fields[4], selection, rows, fields[1], fields[5], tag)
        return _new(ControlPacket, said)

    return layout.size, read


def _nothing(data: bytes) -> None:
    """Read a packet of a shape that no packet has."""


KINDS: Final[dict[int, tuple[int, Callable[[bytes], tuple[int, ...]], Callable[..., Reader[Any]]]]] = {
    SENSOR: (_SENSOR_BYTES, itemgetter(3, 25, 26, 27), _sensor_reader),
    CONTROL: (_CONTROL_BYTES, itemgetter(3, 34, 35), _control_reader),
}
"""Of each kind of packet, by byte 2: how many bytes say its shape, which ones, and what returns for these its length (0 if too
long) and its reader. The reader takes bytes of that length whose CRC is right."""


def length_of(data: bytes) -> int | None:
    """Bytes of the packet that begins so, of 4 bytes at least: 0 if it is none or too long, None if more are needed to tell."""
    kind, known = data[2], len(data)
    if kind == SENSOR:
        if known < _SENSOR_BYTES:
            return None
        values, tagged, used = (data[3] & 0x3F) * data[25] + (data[26] & 0x7F), data[26] >= _TAGGED, _SENSOR_BYTES
    elif kind == CONTROL:
        if known < _CONTROL_BYTES:
            return None
        values, tagged, used = data[34] * data[35], data[3] >= _TAGGED, _CONTROL_BYTES
    else:
        return 0
    return frame_length(used + 4 * values + TAG_BYTES * tagged) if values <= MAX_VALUES else 0


def sensor_length(values: int, tagged: bool = False) -> int:
    """Bytes of a sensor packet that holds so many values, references included.

    >>> sensor_length(1 + 1), sensor_length(3 + 4), sensor_length(3 + 4, tagged=True)
    (48, 64, 72)
    """
    return _sensor_layout(values, tagged).size


def control_length(values: int, tagged: bool = False) -> int:
    """Bytes of a control packet that holds so many values.

    >>> control_length(2), control_length(9)
    (48, 80)
    """
    return _control_layout(values, tagged).size
