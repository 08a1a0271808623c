"""Put a freshness counter and a message authentication code into the room that version 2 keeps for them, and take them out.

What is authenticated is every byte from offset 2 to the end of the freshness, the nonce of the question among them. The CRC
stands outside: it is computed over the tag too.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable
from struct import Struct
from typing import Final, NamedTuple

from transport.wire.fields import CRC_START, frame_length
from transport.wire.version2 import CONTROL, SENSOR, TAG_BYTES

_TAGGED: Final = 0x80
_FRESHNESS: Final = Struct("<I")
_HEAD: Final = Struct("<IQ")


class Tagged(NamedTuple):
    """What a packet with a tag says of itself, nothing of it judged.

    Attributes:
        kind: 0x21 sensor, 0x22 control.
        seq: slot.
        nonce: of the question.
        freshness: counter against replay.
        signed: the bytes that the tag is about.
        tag: `TAG_BYTES` bytes.
    """

    kind: int
    seq: int
    nonce: int
    freshness: int
    signed: bytes
    tag: bytes


def _used(data: bytes) -> tuple[int, int]:
    """Return the bytes up to the last value, and where the flag TAGGED stands; (0, 0) for what is no packet of version 2."""
    if len(data) >= 28 and data[2] == SENSOR:
        return 28 + 4 * ((data[3] & 0x3F) * data[25] + (data[26] & 0x7F)), 26
    if len(data) >= 36 and data[2] == CONTROL:
        return 36 + 4 * data[34] * data[35], 3
    return 0, 0


def with_tag(data: bytes, freshness: int, code: Callable[[bytes], bytes]) -> bytes | None:
    """Return a packet with freshness and tag, None if it is no packet of version 2 or has a tag already.

    Args:
        data: as `encode_sensor` or `encode_control` made it.
        freshness: counter, u32.
        code: the message authentication code of some bytes, `TAG_BYTES` bytes at least.
    """
    used, flag = _used(data)
    if not used or used > len(data) or data[flag] & _TAGGED:
        return None
    body = bytearray(data[2:used])
    body[flag - 2] |= _TAGGED
    body += _FRESHNESS.pack(freshness)
    body += code(bytes(body))[:TAG_BYTES]
    body += bytes(frame_length(2 + len(body)) - 2 - len(body))
    return crc_hqx(body, CRC_START).to_bytes(2, "little") + bytes(body)


def tag_of(data: bytes) -> Tagged | None:
    """Return what a packet with a tag says; None for every other sequence of bytes; never raises.

    Args:
        data: one received packet, any length and content.
    """
    used, flag = _used(data)
    if not used or not data[flag] & _TAGGED or len(data) < used + _FRESHNESS.size + TAG_BYTES:
        return None
    seq, nonce = _HEAD.unpack_from(data, 4)
    end = used + _FRESHNESS.size
    (freshness,) = _FRESHNESS.unpack_from(data, used)
    return Tagged(data[2], seq, nonce, freshness, data[2:end], data[end : end + TAG_BYTES])
