r"""The bits of a CAN frame on the wire, from the start of frame to the third bit of intermission.

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

from functools import lru_cache
from typing import Final, NamedTuple

from transport.can_bus_model.frame import CanFrame

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


class FrameLength(NamedTuple):
    """Bits of a frame with its intermission.

    Attributes:
        nominal: bits at the nominal rate.
        data: bits at the data rate.
    """

    nominal: int
    data: int = 0


def frame_length(frame: CanFrame) -> FrameLength:
    """Return the exact length of a frame with its intermission.

    >>> frame_length(CanFrame(identifier=0x123, data=bytes.fromhex("1122334455667788")))
    FrameLength(nominal=112, data=0)
    >>> frame_length(CanFrame(identifier=0x123, data=bytes([0x55] * 64), fd=True, bitrate_switch=True))
    FrameLength(nominal=29, data=550)
    """
    return wire_bits(frame).length


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
    out: list[str] = []
    last, run = "", 0
    for bit in bits:
        if run == 5:
            last, run = "1" if last == "0" else "0", 1
            out.append(last)
        run = run + 1 if bit == last else 1
        last = bit
        out.append(bit)
    if behind and run == 5:
        out.append("1" if last == "0" else "0")
    return "".join(out)


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
    for bit in bits:
        register = (register << 1 & mask) ^ (polynomial if (register >> top ^ (bit == "1")) & 1 else 0)
    return register & mask
