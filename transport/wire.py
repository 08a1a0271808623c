"""What travels: the fields of sensor and control packets, their layout and their lengths. `transport.packets` reads and writes.

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

The CRC is CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, "123456789" gives 0x29B1), padding included. Both counters grow
by one with each frame. They begin with 1 at the hello, and again at slot 0.

Where TAGGED is set, 8 bytes follow the last value: the first ones of a message authentication code over every byte from
offset 2 to the last value. Who has no key reads over them. The motor's sensor packet has 48 bytes, its control packet 48, with
a tag 48 and 64: each one CAN FD frame. Larger ones travel in several frames, up to 4096 bytes.

An EMPTY packet has no sample, and its outputs and samples are 0; it carries the reference all the same.

What is authenticated is every byte from offset 2 to the last value, the nonce of the question and the counter among them. The CRC
stands outside: it is computed over the tag too.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable, Iterable
from functools import lru_cache
from hashlib import sha256
from struct import Struct
from typing import Final, NamedTuple

HELLO: Final = 0xFFFFFFFF
"""Seq of the rig's hello (is a controller there?), which is answered before slot 0 and never counted."""

MORE: Final = 1
"""Sensor flag: further frames of the same slot follow."""
EMPTY: Final = 2
"""Sensor flag: nothing arrived in this slot, the packet carries no measurement."""

SELECTIONS: Final = ("constant", "generated", "applied", "previous", "both")
"""How the actuator picks a row; the wire code is the index."""

MAX_OUTPUTS: Final = 63
MAX_ROWS: Final = 255
MAX_INPUTS: Final = 255
MAX_VALUES: Final = 1000
"""Values in one packet, references included: what 64 CAN FD frames hold."""
TAU_LIMIT: Final = 32767
"""Larger ages are sent as this one."""

FD_LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""The payload lengths that a CAN FD frame can have."""
_LENGTHS: Final = tuple(next(length for length in FD_LENGTHS if length >= size) for size in range(65))

CRC_START: Final = 0xFFFF
TAG_BYTES: Final = 8
SENSOR: Final = 0x31
CONTROL: Final = 0x32
"""Byte 2 of a packet: version 3, and its kind."""
TAGGED: Final = 0x80
"""The flag that a tag follows: in byte 26 of a sensor packet, in byte 3 of a control packet."""
SENSOR_BYTES: Final = 32
CONTROL_BYTES: Final = 40
"""Before the values."""
_HEAD: Final = Struct("<IQ")
_COUNTER: Final = Struct("<I")
_COUNTS: Final = {SENSOR: 28, CONTROL: 36}


class SensorPacket(NamedTuple):
    """One measurement on its way to the controller.

    Attributes:
        seq: slot k in which the frame is sent (u32, wraps).
        flags: sum of ``MORE`` and ``EMPTY``.
        sample_ns: nominal session time of the newest sample, ns; the samples before it are one period older each.
        y: measurements, newest sample first, float32 on the wire; empty if and only if ``EMPTY`` is set.
        node: number of the sensor node that measured, from 0.
        samples: samples that y holds, each of ``len(y) / samples`` outputs.
        reference: reference of all outputs in slot k, float32 on the wire.
        nodes: number of sensor nodes of the rig.
        nonce: of session and slot (u64), 0 in virtual time.
        counter: of the frames that its sender has sent (u32); it begins anew with slot 0.
    """

    seq: int
    flags: int
    sample_ns: int
    y: tuple[float, ...]
    node: int = 0
    samples: int = 1
    reference: tuple[float, ...] = ()
    nodes: int = 1
    nonce: int = 0
    counter: int = 0


class ControlPacket(NamedTuple):
    """One row of inputs for every delay the actuator may find: *send all, apply one*.

    Attributes:
        seq: slot k that is answered (u32, wraps).
        sample_ns: nominal session time of the newest sample used, ns.
        control_ns: session time at which the rows were computed, ns.
        tau: measured sensor-to-controller delay in samples, -1 while there is no sample; saturates at ``TAU_LIMIT``.
        selection: index into ``SELECTIONS``.
        rows: inputs, shape (rows, m), float32 on the wire.
        echo: digest of the frames that are answered (u64), see `echo`; 0 in virtual time.
        counter: as in `SensorPacket`.
    """

    seq: int
    sample_ns: int
    control_ns: int
    tau: int
    selection: int
    rows: tuple[tuple[float, ...], ...]
    echo: int = 0
    counter: int = 0


def frame_length(size: int) -> int:
    """Shortest length of a CAN FD frame, or multiple of 8 above 64, that holds ``size`` bytes.

    >>> [frame_length(n) for n in (0, 8, 9, 20, 44, 64, 65)]
    [0, 8, 12, 20, 48, 64, 72]
    """
    return _LENGTHS[size] if size <= 64 else -(-size // 8) * 8


class Layout(NamedTuple):
    """One packet shape: writer and reader without CRC, and the length on the wire."""

    write: Struct
    read: Struct
    size: int


@lru_cache(maxsize=2048)  # bounded: shapes may come from the wire
def layout(kind: int, values: int, tagged: bool) -> Layout:
    """Return the layout of the packets of a kind, `SENSOR` or `CONTROL`, with so many values and with a tag or without."""
    if kind == SENSOR:
        head, write, read = SENSOR_BYTES, "<BBIQqBBBBI", "<4xIQqB3xI"
    else:
        head, write, read = CONTROL_BYTES, "<BBIQqqhBBI", "<4xIQqqh2xI"
    used = head + 4 * values + TAG_BYTES * tagged
    size = frame_length(used)
    body = f"{values}f{size - used + TAG_BYTES * tagged}x"  # who reads values reads over the tag
    return Layout(Struct(write + body), Struct(read + body), size)


def sensor_length(values: int, tagged: bool = False) -> int:
    """Bytes of a sensor packet that holds so many values, references included.

    >>> sensor_length(1 + 1), sensor_length(3 + 4), sensor_length(3 + 4, tagged=True)
    (48, 64, 72)
    """
    return layout(SENSOR, values, tagged).size


def control_length(values: int, tagged: bool = False) -> int:
    """Bytes of a control packet that holds so many values.

    >>> control_length(2), control_length(9)
    (48, 80)
    """
    return layout(CONTROL, values, tagged).size


class Tagged(NamedTuple):
    """What a packet with a tag says of itself, nothing of it judged.

    Attributes:
        kind: 0x31 sensor, 0x32 control.
        seq: slot.
        nonce: of the question; of an answer its echo.
        counter: of the frames of its sender.
        signed: the bytes that the tag is about.
        tag: `TAG_BYTES` bytes.
    """

    kind: int
    seq: int
    nonce: int
    counter: int
    signed: bytes
    tag: bytes


def _used(data: bytes) -> tuple[int, int]:
    """Return the bytes up to the last value, and where the flag TAGGED stands; (0, 0) for what is no packet."""
    if len(data) >= SENSOR_BYTES and data[2] == SENSOR:
        return SENSOR_BYTES + 4 * ((data[3] & 0x3F) * data[25] + (data[26] & 0x7F)), 26
    if len(data) >= CONTROL_BYTES and data[2] == CONTROL:
        return CONTROL_BYTES + 4 * data[34] * data[35], 3
    return 0, 0


def echo(frames: Iterable[bytes]) -> int:
    """Return the digest that answers these sensor frames: the first 8 bytes of their SHA-256, a little-endian number.

    Of each frame every byte from offset 2 to its last value counts, with the flag TAGGED taken as 0: neither padding nor a tag
    changes it.

    Args:
        frames: sensor packets of a slot, in their order.

    >>> echo([]) == int.from_bytes(bytes.fromhex("e3b0c44298fc1c14"), "little")
    True
    """
    digest = sha256()
    for data in frames:
        if data[26] & TAGGED:
            data = data[:26] + bytes((data[26] & 0x7F,)) + data[27:]
        digest.update(data[2 : 32 + 4 * ((data[3] & 0x3F) * data[25] + data[26])])
    return int.from_bytes(digest.digest()[:8], "little")


def with_tag(data: bytes, code: Callable[[bytes], bytes]) -> bytes | None:
    """Return a packet with its tag, None if it is no packet or has a tag already; a CRC that was wrong stays wrong.

    Args:
        data: as `encode_sensor` or `encode_control` made it.
        code: the message authentication code of some bytes, `TAG_BYTES` bytes at least.
    """
    used, flag = _used(data)
    if not used or used > len(data) or data[flag] & TAGGED:
        return None
    wrong = crc_hqx(data[2:], CRC_START) ^ (data[0] | data[1] << 8)
    body = bytearray(data[2:used])
    body[flag - 2] |= TAGGED
    body += code(bytes(body))[:TAG_BYTES]
    body += bytes(frame_length(2 + len(body)) - 2 - len(body))
    return (crc_hqx(body, CRC_START) ^ wrong).to_bytes(2, "little") + bytes(body)


def tag_of(data: bytes) -> Tagged | None:
    """Return what a packet with a tag says; None for every other sequence of bytes; never raises.

    Args:
        data: one received packet, any length and content.
    """
    used, flag = _used(data)
    if not used or not data[flag] & TAGGED or len(data) < used + TAG_BYTES:
        return None
    seq, nonce = _HEAD.unpack_from(data, 4)
    (counter,) = _COUNTER.unpack_from(data, _COUNTS[data[2]])
    return Tagged(data[2], seq, nonce, counter, data[2:used], data[used : used + TAG_BYTES])
