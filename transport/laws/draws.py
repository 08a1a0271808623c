"""Network laws at work, slot by slot: the ages that a law with at most one step of memory draws, and what becomes of packets."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from transport.draws import COPIED, LOST, NO_MODE, SENT, Draw
from transport.laws import SLOT_TOLERANCE
from transport.laws.stochastic_matrix import BLOCK, cumulative

if TYPE_CHECKING:
    from transport.laws.packet import PacketLaw

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
        law: what runs.
        rng: its own stream.
        period_s, deadline_s: of the slots, see `transport.laws.packet.PacketLaw.start`.
    """

    def __init__(self, law: PacketLaw, rng: np.random.Generator, period_s: float, deadline_s: float) -> None:
        from transport.laws.latency import latency  # loaded where packets have latencies

        latencies = latency(law.latency)
        self._latency = latencies.in_order()
        self._copy_latency = latencies.sampler()
        self._losses = law.channel_losses()
        self._rows = [cumulative(row) for row in law.transition_matrix().tolist()]
        self._row = cumulative(law.stationary().tolist())
        self._duplication = law.duplication
        self._latest = LATEST if law.discard_older is None else law.discard_older
        self._period_s = period_s
        self._deadline_s = deadline_s
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
