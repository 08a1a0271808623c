"""Faults of a bus on a time line: bits that are disturbed for a while, at a rate or in chosen frames, and nodes off the bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from transport.can_bus_model.bit_rates import BitRates
from transport.can_bus_model.bus import CanBus
from transport.can_bus_model.can_frame import CanFrame
from transport.can_bus_model.disturbances import BitErrors


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

    def memory(self) -> list[Any]:
        """Return what it remembers, as plain values."""
        return [self._faults, self._edges, sorted(self._off)]

    def remember(self, memory: list[Any]) -> None:
        """Take over what `memory` returned."""
        faults, self._edges, off = memory
        self._faults, self._off = tuple(BusFault._make([*each[:4], tuple(each[4])]) for each in faults), set(off)


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
