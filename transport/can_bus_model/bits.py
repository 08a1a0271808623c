"""The bits of a CAN frame on the wire, from the start of frame to the third bit of intermission, and how many there can be.

Classic frames are stuffed up to the last bit of their CRC: behind five equal bits one of the other value stands, and it counts
for the next five. CAN FD frames are stuffed so up to their data; the stuff count and the CRC behind it have a fixed stuff bit in
front of every four bits, which is the complement of the bit before it. A fixed stuff bit takes the place of a dynamic one that is
due behind the last data bit.

The bit rate changes at the sample points of the BRS bit and of the CRC delimiter. The parts of those two bits at the nominal rate
make one nominal bit, those at the data rate one data bit, wherever the sample points are: the BRS bit counts as nominal and the
CRC delimiter as data.

Reference: ISO 11898-1:2015, 10.4 and 10.5; the lengths without content are those of linux/can/length.h.
"""

from __future__ import annotations

import re
from functools import cache, lru_cache
from typing import Final, NamedTuple

from transport.can_bus_model import CanFrame, FrameLength
from transport.errors import FieldError
from transport.wire import FD_LENGTHS

ACK_TO_INTERMISSION: Final = "0" + "1" + "1111111" + "111"
"""ACK slot as the receivers fill it, ACK delimiter, end of frame, intermission: 12 bits at the nominal rate."""

INTERMISSION: Final = 3


class WireBits(NamedTuple):
    """A frame on the wire.

    Attributes:
        bits: ``0`` dominant, ``1`` recessive.
        fast: first bit, and first one after it, that count at the data bit rate; equal without bit-rate switch.
    """

    bits: str
    fast: tuple[int, int]

    @property
    def length(self) -> FrameLength:
        """How many bits that is."""
        data = self.fast[1] - self.fast[0]
        return FrameLength(len(self.bits) - data, data)

    @property
    def ack_slot(self) -> int:
        """Position of the ACK slot."""
        return len(self.bits) - len(ACK_TO_INTERMISSION)


def frame_length(frame: CanFrame) -> FrameLength:
    """Return the exact length of a frame with its intermission.

    >>> frame_length(CanFrame(identifier=0x123, data=bytes.fromhex("1122334455667788")))
    FrameLength(nominal=112, data=0)
    >>> frame_length(CanFrame(identifier=0x123, data=bytes([0x55] * 64), fd=True, bitrate_switch=True))
    FrameLength(nominal=29, data=550)
    """
    return wire_bits(frame).length


_FIVE: Final = re.compile("0{5}|1{5}")


@lru_cache(maxsize=4096)
def wire_bits(frame: CanFrame) -> WireBits:
    """Return the bits of a frame, as a transmitter sees them that is acknowledged."""
    payload = "".join(f"{byte:08b}" for byte in frame.data)
    if not frame.fd:
        head = f"{_identifier(frame, f'{frame.remote:b}')}{'00' if frame.extended else '0'}{frame.length_code:04b}{payload}"
        body = _stuffed(f"{head}{crc(head, 15, 0x4599, 0):015b}", behind=True)
        return WireBits(f"{body}1{ACK_TO_INTERMISSION}", (0, 0))
    to_switch = f"{_identifier(frame, '0')}10{frame.bitrate_switch:b}"
    body = _stuffed(f"{to_switch}{frame.error_state:b}{frame.length_code:04b}{payload}", behind=False)
    inserted = (len(body) - len(to_switch) - 5 - len(payload)) % 8
    gray = inserted ^ inserted >> 1
    count = f"{gray:03b}{gray.bit_count() % 2}"
    width, polynomial = (17, 0x1685B) if len(frame.data) <= 16 else (21, 0x102899)
    field = count + f"{crc(body + count, width, polynomial, 1 << width - 1):0{width}b}"
    for i in range(0, len(field), 4):
        body += ("1" if body[-1] == "0" else "0") + field[i : i + 4]
    first = len(_stuffed(to_switch, behind=False))
    return WireBits(f"{body}1{ACK_TO_INTERMISSION}", (first, len(body) + 1) if frame.bitrate_switch else (0, 0))


def _identifier(frame: CanFrame, request: str) -> str:
    """Return start of frame, identifier, and the bits up to IDE or the remote request behind 29 bits."""
    if frame.extended:
        return f"0{frame.identifier >> 18:011b}11{frame.identifier & 0x3FFFF:018b}{request}"
    return f"0{frame.identifier:011b}{request}0"


def _stuffed(bits: str, *, behind: bool) -> str:
    """Insert stuff bits; one that is due behind the last bit too, where asked."""
    at = 0
    while (run := _FIVE.search(bits, at)) is not None:
        at = run.end()
        if at == len(bits) and not behind:
            break
        bits = f"{bits[:at]}{'1' if bits[at - 1] == '0' else '0'}{bits[at:]}"  # it counts for the next run
    return bits


def crc(bits: str, width: int, polynomial: int, start: int) -> int:
    """Return the remainder of so many bits.

    Args:
        bits: what it covers.
        width: bits of the remainder.
        polynomial: without its highest term.
        start: the register before the first bit.

    >>> f"{crc('0' * 19, 15, 0x4599, 0):015b}"
    '000000000000000'
    """
    top, mask, register = width - 1, (1 << width) - 1, start
    first = len(bits) % 8
    for bit in bits[:first]:
        register = (register << 1 & mask) ^ (polynomial & mask if (register >> top ^ (bit == "1")) & 1 else 0)
    if len(bits) > first:
        table, shift = _remainders(width, polynomial), width - 8
        for byte in int(bits[first:], 2).to_bytes(len(bits) // 8, "big"):
            register = (register << 8 & mask) ^ table[register >> shift ^ byte]
    return register


@cache
def _remainders(width: int, polynomial: int) -> tuple[int, ...]:
    """Return the remainder of each byte, so that eight bits are divided at once."""
    found, mask = [], (1 << width) - 1
    for byte in range(256):
        register = byte << width - 8
        for _ in range(8):
            register = register << 1 ^ (polynomial | 1 << width if register >> width - 1 & 1 else 0)
        found.append(register & mask)
    return tuple(found)


def frame_bounds(
    length: int, *, extended: bool = False, fd: bool = False, bitrate_switch: bool = False
) -> tuple[FrameLength, FrameLength]:  # fmt: skip
    r"""Return the shortest and the longest that a frame can be, with its intermission.

    Of n stuffed bits there are at most :math:`(n - 1)/4` more, and none at least. Without bit-rate switch the longest is that of
    the table of the Linux kernel, 55 + 10 s and 80 + 10 s bits for s bytes of classic CAN. With it the header and the data are
    bounded each for itself. A remote frame is as long as one without data.

    Args:
        length: bytes of data.
        extended: identifier of 29 bits.
        fd: CAN FD.
        bitrate_switch: with the data bit rate; CAN FD only.

    Raises:
        ValueError: there is no frame of that length.

    Reference: linux/can/length.h; Davis, Burns, Bril, Lukkien, Controller Area Network (CAN) schedulability analysis: refuted,
    revisited and revised, Real-Time Systems 35 (2007), equations (1) and (2).

    >>> [sum(frame_bounds(8 if not fd else 64, extended=e, fd=fd)[1]) for fd in (False, True) for e in (False, True)]
    [135, 160, 712, 736]
    >>> frame_bounds(8)[0], frame_bounds(64, fd=True, bitrate_switch=True)[0]
    (FrameLength(nominal=111, data=0), FrameLength(nominal=29, data=550))
    """
    allowed = FD_LENGTHS if fd else range(9)
    if length not in allowed:
        raise FieldError("length", f"{length} bytes, expected {'one of ' + ', '.join(map(str, allowed)) if fd else '0 to 8'}")
    if bitrate_switch and not fd:
        raise FieldError("fd", "a bit-rate switch needs CAN FD")
    bits = 8 * length
    if not fd:
        body = (39 if extended else 19) + bits + 15
        return FrameLength(body + 13), FrameLength(body + (body - 1) // 4 + 13)
    crc_field = 28 if length <= 16 else 33
    if not bitrate_switch:
        body = (41 if extended else 22) + bits
        return FrameLength(body + crc_field + 12), FrameLength(body + (body - 1) // 4 + crc_field + 12)
    head, rest = 33 if extended else 14, 5 + bits  # FDF, res and BRS are 1, 0, 1: stuff bits stand before FDF and behind BRS
    most = FrameLength(head + (head - 1) // 4 + 3 + 12, rest + rest // 4 + crc_field)
    return FrameLength(head + 3 + 12, rest + crc_field), most
