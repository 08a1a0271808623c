"""How long a frame is at most, whatever its data and identifier."""

from __future__ import annotations

from transport.can_bus_model.bits import FrameLength
from transport.errors import FieldError
from transport.wire.fields import FD_LENGTHS


def longest_frame(
    length: int, *, extended: bool = False, fd: bool = False, bitrate_switch: bool = False, remote: bool = False
) -> FrameLength:
    r"""Return a bound of the length of a frame with its intermission: of n stuffed bits at most :math:`(n - 1)/4` more.

    Without bit-rate switch this is the table of the Linux kernel, 55 + 10 s and 80 + 10 s bits for s bytes of classic CAN. With
    it the header and the data are bounded each for itself.

    Args:
        length: bytes of data.
        extended: identifier of 29 bits.
        fd: CAN FD.
        bitrate_switch: with the data bit rate; CAN FD only.
        remote: a remote frame; its length counts nothing.

    Raises:
        ValueError: there is no frame of that length.

    Reference: linux/can/length.h; Davis, Burns, Bril, Lukkien, Controller Area Network (CAN) schedulability analysis: refuted,
    revisited and revised, Real-Time Systems 35 (2007), equations (1) and (2).

    >>> [sum(longest_frame(8, extended=e)) for e in (False, True)], [sum(longest_frame(64, extended=e, fd=True)) for e in (0, 1)]
    ([135, 160], [712, 736])
    """
    allowed = FD_LENGTHS if fd else range(9)
    if length not in allowed:
        raise FieldError("length", f"{length} bytes, expected {'one of ' + ', '.join(map(str, allowed)) if fd else '0 to 8'}")
    if (bitrate_switch and not fd) or (remote and fd):
        raise FieldError("fd", "a bit-rate switch needs CAN FD, and CAN FD has no remote frame")
    bits = 0 if remote else 8 * length
    if not fd:
        body = (39 if extended else 19) + bits + 15
        return FrameLength(body + (body - 1) // 4 + 13)
    crc_field = 28 if length <= 16 else 33
    body = (41 if extended else 22) + bits
    if not bitrate_switch:
        return FrameLength(body + (body - 1) // 4 + crc_field + 12)
    head, rest = 33 if extended else 14, 5 + bits  # FDF, res and BRS are 1, 0, 1: stuff bits stand before FDF and behind BRS
    return FrameLength(head + (head - 1) // 4 + 3 + 12, rest + rest // 4 + crc_field)
