"""Faults of a bus on a time line: bits that are disturbed for a while, at a rate or in chosen frames, and nodes off the bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from transport.can_bus_model.bit_rates import BitRates
from transport.can_bus_model.bits import BitErrors, CanFrame


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


class PlannedErrors:
    """Which bit of the next frame is disturbed, by the bus's own rate and by its faults; see `transport.can_bus_model.bus.Noise`.

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
