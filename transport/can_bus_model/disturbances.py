"""What goes wrong on a bus: bits that all nodes see as the other one, what that costs, and faults on a time line.

A fault disturbs bits for a while, at a rate or in chosen frames, or takes nodes off the bus.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

import numpy as np

from transport.can_bus_model import BitRates, CanFrame, FrameLength
from transport.can_bus_model.bits import INTERMISSION, wire_bits
from transport.errors import FieldError

if TYPE_CHECKING:
    from transport.can_bus_model.bus import CanBus

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


def flag_bits(wire: str, bit: int, *, dominant: bool, answered: bool) -> int:
    """Return how long the error flags behind a disturbed bit last, one upon the other: 6 to 12 bits.

    The sender notices at once and sends six equal bits. The others notice with the sixth equal bit on the wire, or in a field
    where the bit cannot be, and send six more.

    Args:
        wire: bits of the frame as its sender sent them.
        bit: the disturbed one.
        dominant: whether the sender's flag is: it is error active.
        answered: whether there is another node that sends a flag.

    >>> wire = "0100001" + "01" * 20
    >>> [flag_bits(wire, bit, dominant=True, answered=True) for bit in (0, 6, len(wire) - 1)]
    [12, 7, 6]
    """
    if not answered or bit >= len(wire) - 13:
        return 6  # no other node, or a bit that must be recessive: all notice at once
    seen = wire[:bit] + ("1" if wire[bit] == "0" else "0")
    flag = "0" if dominant else "1"
    run = len(seen) - len(seen.rstrip(flag))
    return 6 if run >= 6 else 12 - run


def destroyed_bits(frame: CanFrame, bit: int, *, dominant: bool, answered: bool) -> FrameLength:
    """Return how many bits a destroyed frame holds the bus, with error flags, delimiter and intermission.

    Args:
        frame: what was sent.
        bit: the disturbed one.
        dominant, answered: see `flag_bits`.
    """
    wire = wire_bits(frame)
    first, end = wire.fast
    fast = min(max(bit + 1 - first, 0), end - first)
    flags = flag_bits(wire.bits, bit, dominant=dominant, answered=answered)
    return FrameLength(bit + 1 - fast + flags + _DELIMITER + INTERMISSION, fast)


class BusFault(NamedTuple):
    """A time for which something is wrong on a bus.

    Attributes:
        first_ns, end_ns: from when, until when.
        rate: probability that a bit is disturbed, None where nothing is at random.
        identifier: of the frames of which the bit in the middle is disturbed; None: of none.
        off: numbers of the nodes that are off the bus.
    """

    first_ns: int
    end_ns: int
    rate: float | None = None
    identifier: int | None = None
    off: tuple[int, ...] = ()


class PlannedOutages:
    """Which nodes are off the bus when."""

    def __init__(self) -> None:
        self._faults: tuple[BusFault, ...] = ()
        self._edges: list[int] = []  # instants at which a fault begins or ends, ns
        self._off: set[int] = set()

    def plan(self, faults: Sequence[BusFault], past_ns: int) -> None:
        """Replace the time line; what is past stays as it was.

        Args:
            faults: with their nodes.
            past_ns: up to where time has passed.
        """
        self._faults = tuple(fault for fault in faults if fault.off)
        self._edges = sorted({ns for f in self._faults for ns in (f.first_ns, f.end_ns) if ns >= past_ns})

    def next_edge(self, ns: int) -> int | None:
        """Return the next instant up to this one at which a fault begins or ends, None if there is none; it comes once."""
        return self._edges.pop(0) if self._edges and self._edges[0] <= ns else None

    def switch(self, bus: CanBus, ns: int) -> None:
        """Take nodes off the bus, or let them come back.

        Args:
            bus: in which time has passed up to this instant.
            ns: an edge.
        """
        off = {i for fault in self._faults if fault.first_ns <= ns < fault.end_ns for i in fault.off}
        for i in sorted(off - self._off):
            bus.switch_off(i, BitRates.units(ns))
        for i in sorted(self._off - off):
            bus.switch_on(i, BitRates.units(ns))
        self._off = off

    def forget(self, node: int) -> None:
        """Leave a node alone that has left the bus."""
        self._off.discard(node)
        self._faults = tuple(fault._replace(off=tuple(i for i in fault.off if i != node)) for fault in self._faults)

    def memory(self) -> tuple[Sequence[BusFault], Sequence[int], Sequence[int]]:
        """Return what it remembers."""
        return self._faults, self._edges, sorted(self._off)

    def remember(self, faults: Sequence[Sequence[Any]], edges: Sequence[int], off: Sequence[int]) -> None:
        """Take over what `memory` returned."""
        self._faults, self._edges, self._off = tuple(BusFault._make(each) for each in faults), list(edges), set(off)


class PlannedErrors:
    """Which bit of the next frame is disturbed, by the bus's own rate and by its faults; see `Noise`.

    Args:
        always: the bus's own disturbances; None: none.
        rng: the stream of the faults; nothing else may draw from it.
    """

    def __init__(self, always: BitErrors | None, rng: np.random.Generator) -> None:
        self._always, self._rng = always, rng
        self._faults: list[tuple[int, int, BitErrors | None, int | None]] = []

    def plan(self, faults: Sequence[BusFault]) -> None:
        """Replace the time line."""
        self._faults = [
            (BitRates.units(first), BitRates.units(end), None if rate is None else BitErrors(rate, self._rng), identifier)
            for first, end, rate, identifier, _ in faults
            if rate is not None or identifier is not None
        ]

    def first(self, bits: int, start: int, frame: CanFrame) -> int | None:
        """Return the first disturbed bit of a frame, None if there is none; it counts when the frame begins."""
        found = [self._always.first(bits)] if self._always is not None else []
        for begin, end, errors, identifier in self._faults:
            if begin <= start < end:
                if errors is not None:
                    found.append(errors.first(bits))
                elif identifier == frame.identifier:
                    found.append(bits // 2)
        return min((bit for bit in found if bit is not None), default=None)
