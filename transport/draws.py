"""Network laws at work, slot by slot, and the record of what they decide: a `Draw` for each decision about a slot or a packet."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    import numpy as np

SLOT_TOLERANCE: Final = 1e-9
"""Share of a slot by which a packet may come behind a deadline and be taken as in time: rounding, not lateness."""

REASONS: Final[tuple[str, ...]] = (
    "delivered",  # arrives for the first time, newer than all before
    "repeated",  # age law: the newest packet of an earlier slot is still the newest
    "disordered",  # arrives for the first time, after a newer one
    "duplicated",  # the second copy of a packet that has arrived already
    "superseded",  # age law: never was the newest at the receiver, and never can be
    "lost",  # the loss law took it
    "overflow",  # more packets in flight than the stated queue holds
    "none-yet",  # the law points before the first slot
    "absent",  # the law points at a packet that was never offered (late or not sent)
    "sent",  # packet law: on its way, with this latency
    "copied",  # packet law: a second copy on its way, with its own latency
    "replaced",  # on a bus with arbitration: a newer packet of its node took its place before the bus was free
    "cut",  # a fault on the time line: it would have arrived while the link was cut
    "corrupted",  # a fault on the time line: it arrived with a flipped bit, and the receiver's CRC refused it
    "off-bus",  # a fault on the time line: its sender, or its receiver, was off the bus
)
"""Names of the reason codes: `REASONS[draw.reason]`."""

DELIVERED: Final = 0
REPEATED: Final = 1
DISORDERED: Final = 2
DUPLICATED: Final = 3
SUPERSEDED: Final = 4
LOST: Final = 5
OVERFLOW: Final = 6
NONE_YET: Final = 7
ABSENT: Final = 8
SENT: Final = 9
COPIED: Final = 10
REPLACED: Final = 11
CUT: Final = 12
CORRUPTED: Final = 13
OFF_BUS: Final = 14

NO_MODE: Final = -1
"""`Draw.mode` of a row that books a packet's fate and is no draw of the law."""


class Draw(NamedTuple):
    """One decision of an emulated network.

    Rows with `mode >= 0` are the draws of the law: exactly one per slot, in slot order, for both families of law. Rows
    with `mode == NO_MODE` book what became of a packet: arrivals of a packet law, superseded packets, stand-ins for
    absent ones.

    Attributes:
        slot: slot k in which it was decided.
        packet_slot: slot g in which the packet was sent, -1 when there is no packet; on a bus with arbitration the slot of its
            newest sample, from which on it waited for the bus.
        mode: mode of the law, or `NO_MODE`.
        age: slots; in a draw of an age law the age that the law demands, otherwise `slot - packet_slot`
            (for "sent" and "copied": at arrival; on a bus with arbitration: since the bus carried it); -1 where it has no
            meaning.
        latency_s: seconds on the way; for age laws age times T; NaN where it has no meaning.
        reason: index into `REASONS`.
    """

    slot: int
    packet_slot: int
    mode: int
    age: int
    latency_s: float
    reason: int


BLOCK: Final = 128
"""Uniform numbers drawn at once: 1024 take 3 ns less each, and 20 us of one slot where caches are cold."""


def cumulative(row: Sequence[float]) -> list[float]:
    """Return the cumulative row for `bisect_right(row, u)`, 0 <= u < 1: no entry of probability 0 is ever hit.

    The sum is set to exactly 1 from the last positive entry on, so that rounding can neither reach beyond the row nor
    hit a trailing zero.
    """
    sums = list(accumulate(row))
    last = max(j for j, p in enumerate(row) if p > 0.0)
    return [min(c, 1.0) for c in sums[:last]] + [1.0] * (len(sums) - last)


def uniforms(rng: np.random.Generator) -> Iterator[float]:
    """Yield uniform numbers of [0, 1) without end, drawn in blocks: 30 ns each instead of 300."""
    while True:
        yield from rng.random(BLOCK).tolist()


State = tuple[int, int]
"""Mode, and its age in slots."""


class ChainDraws:
    """A running chain: one uniform number a slot says which mode is next.

    Args:
        first: cumulative row of the mode in slot 0, see `cumulative`.
        rows: cumulative rows, one for every mode.
        ages: of the modes, slots.
        rng: the stream of the law.
    """

    def __init__(self, first: list[float], rows: Sequence[list[float]], ages: Sequence[int], rng: np.random.Generator) -> None:
        self._row, self._rows, self._rng = first, list(rows), rng
        self._states: Final[list[State]] = list(enumerate(ages))
        self._left = self._block()  # now: slot 0 does not pay for it

    def _block(self) -> list[float]:
        uniform: list[float] = self._rng.random(BLOCK).tolist()
        uniform.reverse()
        return uniform

    def draw(self) -> State:
        """Return mode and age of the next slot."""
        if not self._left:
            self._left = self._block()
        mode = bisect_right(self._row, self._left.pop())
        self._row = self._rows[mode]
        return self._states[mode]


LATEST: Final = 1_000_000_000
"""Slots; heavy tails reach further, the log's 32-bit ages do not."""


class PacketDraws:
    """A running packet law.

    Args:
        following: gives one packet after the other its latency, s, from a number of [0, 1); infinite: it is lost.
        copied: the same of a copy.
        losses: probability of a loss in every mode of the channel.
        first: cumulative row of the mode in slot 0, see `cumulative`.
        rows: cumulative rows, one for every mode.
        duplication: probability of a copy.
        latest: slots; what comes later is lost.
        period_s, deadline_s: of the slots, see `transport.laws.packet.PacketLaw.start`.
        rng: its own stream.
    """

    def __init__(
        self, following: Callable[[float], float], copied: Callable[[float], float], losses: Sequence[float], first: list[float],
        rows: Sequence[list[float]], *, duplication: float, latest: int, period_s: float, deadline_s: float,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self._latency, self._copy_latency, self._losses = following, copied, tuple(losses)
        self._row, self._rows = first, list(rows)
        self._duplication, self._latest = duplication, latest
        self._period_s, self._deadline_s = period_s, deadline_s
        self._numbers: Callable[[], list[float]] = _fives(rng).__next__

    def draw(self, k: int) -> list[Draw]:
        """Return what becomes of the packet of slot k: sent or lost, and copied."""
        u_mode, u_loss, u_latency, u_copy, u_copy_latency = self._numbers()
        mode = bisect_right(self._row, u_mode)
        self._row = self._rows[mode]
        latency_s = self._latency(u_latency)
        if u_loss < self._losses[mode] or latency_s == math.inf:
            return [Draw(k, k, mode, -1, math.nan, LOST)]
        slots = self._slots(latency_s)
        draws = [Draw(k, k, mode, slots, latency_s, SENT) if slots <= self._latest else Draw(k, k, mode, -1, math.nan, LOST)]
        if u_copy < self._duplication:
            latency_s = self._copy_latency(u_copy_latency)
            slots = self._slots(latency_s)
            if slots <= self._latest:
                draws.append(Draw(k, k, NO_MODE, slots, latency_s, COPIED))
        return draws

    def _slots(self, latency_s: float) -> int:
        slots = math.ceil((latency_s - self._deadline_s) / self._period_s - SLOT_TOLERANCE)
        return min(max(0, slots), LATEST)


def _fives(rng: np.random.Generator) -> Iterator[list[float]]:
    while True:
        yield from rng.random((BLOCK, 5)).tolist()
