"""Disturbances on the wire: which bit of a frame is seen as the other one by all nodes, and what that costs."""

from __future__ import annotations

from bisect import bisect_right
from typing import Final, Protocol

import numpy as np

from transport.can_bus_model.bits import ACK_TO_INTERMISSION, INTERMISSION, FrameLength, WireBits, wire_bits
from transport.can_bus_model.can_frame import CanFrame
from transport.can_bus_model.node import Waiting
from transport.errors import FieldError

_DELIMITER: Final = 8


class Noise(Protocol):
    """Says which bit of the next frame is disturbed."""

    def first(self, bits: int, start: int, frame: CanFrame) -> int | None:
        """Return its position, None if there is none.

        Args:
            bits: that the frame has.
            start: first instant of its start of frame, in units.
            frame: what is sent.
        """
        ...


_MOST_BITS: Final = 800  # longer than any frame


class BitErrors:
    r"""Every bit is disturbed with the same probability p, independent of the others.

    One number u is drawn a frame: bit i is the first disturbed one where :math:`1 - (1-p)^i \le u < 1 - (1-p)^{i+1}`.

    Args:
        rate: p, 0 to 1.
        rng: the stream of this bus; nothing else may draw from it.

    Raises:
        ValueError: p is no probability.
    """

    def __init__(self, rate: float, rng: np.random.Generator) -> None:
        if not 0.0 <= rate <= 1.0:
            raise FieldError("bit_error_rate", f"{rate:g}, expected a probability")
        self._random = rng.random
        self._until: list[float] = []
        whole = 1.0
        for _ in range(_MOST_BITS if rate else 0):
            whole *= 1.0 - rate
            self._until.append(1.0 - whole)

    def first(self, bits: int, start: int = 0, frame: CanFrame | None = None) -> int | None:
        """Return the first disturbed bit of the next frame, None if there is none.

        Args:
            bits: that the frame has.
            start, frame: of no account: all frames are alike.
        """
        if not self._until:
            return None
        hit = bisect_right(self._until, float(self._random()))
        return hit if hit < bits else None


def flag_bits(wire: str, bit: int, *, dominant: bool, answered: bool = True) -> int:
    """Return how long the error flags behind a disturbed bit last, one upon the other: 6 to 12 bits.

    The sender notices at once and sends six equal bits. The others notice with the sixth equal bit on the wire, or in a field
    where the bit cannot be, and send six more.

    Args:
        wire: bits of the frame as its sender sent them.
        bit: the disturbed one.
        dominant: whether the sender's flag is: it is error active.
        answered: whether there is another node that sends a flag.

    >>> wire = "0100001" + "01" * 20
    >>> [flag_bits(wire, bit, dominant=True) for bit in (0, 6, len(wire) - 1)]
    [12, 7, 6]
    """
    if not answered or bit >= len(wire) - 13:
        return 6  # no other node, or a bit that must be recessive: all notice at once
    seen = wire[:bit] + ("1" if wire[bit] == "0" else "0")
    flag = "0" if dominant else "1"
    run = len(seen) - len(seen.rstrip(flag))
    return 6 if run >= 6 else 12 - run


def destroyed_bits(sent: Waiting, length: FrameLength, bit: int, *, dominant: bool, answered: bool) -> FrameLength:
    """Return how many bits a destroyed frame holds the bus, with error flags, delimiter and intermission.

    Args:
        sent: the frame.
        length: bits that it has.
        bit: the disturbed one.
        dominant, answered: see `flag_bits`.
    """
    if sent.length is None:
        wire = wire_bits(sent.frame)
    else:  # no content: no equal bits in a row, and the data bit rate up to the CRC delimiter
        first = length.nominal - len(ACK_TO_INTERMISSION)
        wire = WireBits(("01" * sum(length))[: sum(length)], (first, first + length.data))
    first, end = wire.fast
    fast = min(max(bit + 1 - first, 0), end - first)
    flags = flag_bits(wire.bits, bit, dominant=dominant, answered=answered)
    return FrameLength(bit + 1 - fast + flags + _DELIMITER + INTERMISSION, fast)
