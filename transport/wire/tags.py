"""Put a message authentication code into the room that a packet keeps for it, and take it out; digests of what is answered.

What is authenticated is every byte from offset 2 to the last value, the nonce of the question and the counter among them. The CRC
stands outside: it is computed over the tag too.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable, Iterable
from hashlib import sha256
from struct import Struct
from typing import Final, NamedTuple

from transport.wire import CONTROL, CONTROL_BYTES, CRC_START, SENSOR, SENSOR_BYTES, TAG_BYTES, TAGGED, frame_length

_HEAD: Final = Struct("<IQ")
_COUNTER: Final = Struct("<I")
_COUNTS: Final = {SENSOR: 28, CONTROL: 36}


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
