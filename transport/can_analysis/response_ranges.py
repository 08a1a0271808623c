r"""Bounds of the response time of every instance of a message, where offsets are known: a loop has slots, not rates.

The bus never waits while a frame is queued, and never interrupts one. So after n frames all that matters is which instances are
through and when the bus is idle, from :math:`E` at the earliest to :math:`L` at the latest. Of message i the next instance is
queued between :math:`r_i` and :math:`r_i + J_i`; it may be the next on the bus if

.. math:: \max(E, r_i) \le \min\bigl(\max(L, \min_j r_j + J_j),\ \min_{j \in hp(i)} r_j + J_j - 1\bigr)

with hp(i) the messages that win over it, and then it starts between the two sides. All orders in which frames may come are
followed; those that end with the same instances through, at times that overlap, are followed together. What holds in one
hyperperiod holds in all later ones once it begins with nothing that the one before it did not begin with.

Lengths are between the shortest and the longest frame. That shorter frames may delay others is covered.

Reference: Nasri, Brandenburg, An exact and sustainable analysis of non-preemptive scheduling, RTSS 2017, sections III and IV.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import lcm
from typing import Final

from transport.can_analysis import InUnits, PeriodicMessage, in_order
from transport.can_bus_model import BitRates
from transport.can_bus_model.bits import INTERMISSION
from transport.errors import NotKnown

MOST_FRAMES: Final = 40_000
"""Frames that are followed, over all hyperperiods."""
MOST_ORDERS: Final = 500
"""Orders in which frames may come that are followed at once."""

Interval = tuple[int, int]
States = dict[tuple[int, ...], list[Interval]]
"""Instances of every message that are through, to the intervals in which the bus becomes idle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResponseRanges:
    """How long every instance takes, in units, from when it is due to the end of its EOF.

    Args:
        hyperperiod_ns: after which everything comes again.
        lead: of each message, instances before those that come again.
        count: of each message, instances in a hyperperiod.
        ranges: (message, instance) to the least and the most; instances from `lead` on stand for all that come again.
    """

    hyperperiod_ns: int
    lead: tuple[int, ...]
    count: tuple[int, ...]
    ranges: Mapping[tuple[int, int], Interval] = field(repr=False)

    def of(self, message: int, instance: int) -> Interval:
        """Return the least and the most of an instance, in units.

        Args:
            message: its place among those that were given.
            instance: counted from 0.
        """
        first, every = self.lead[message], self.count[message]
        at = instance if instance < first else first + (instance - first) % every
        return self.ranges[message, at]


def response_ranges(messages: Sequence[PeriodicMessage], rates: BitRates) -> ResponseRanges:
    """Return how long every instance of every message takes.

    Args:
        messages: all that is sent on the bus, with offsets; each node queues by priority, and nothing is disturbed.
        rates: of the bus.

    Raises:
        NotKnown: the ranges do not repeat, or too many orders are possible.
        ValueError: two messages have one identifier.
    """
    order = in_order(messages, rates)
    cycle, gap = lcm(*(each.period for each in order)), INTERMISSION * rates.bit
    count = tuple(cycle // each.period for each in order)
    frames = sum(count)
    if 2 * frames > MOST_FRAMES:
        said = f"the messages come again after {rates.ns(cycle) / 1e9:g} s and {frames} frames"
        raise NotKnown(f"{said}, at most {MOST_FRAMES // 2} are followed")
    if sum(each.length * n for each, n in zip(order, count)) > cycle:
        raise NotKnown("the messages may need more than the whole bus")
    found: dict[tuple[int, int], Interval] = {}
    states, before, last = _idle({(0,) * len(order): [(0, 0)]}, order), None, ()
    for passed in range(MOST_FRAMES // frames + 1):
        begun = _begun(states, count, passed, cycle)
        if before is not None and _within(begun, before):
            return _closed(found, order, count, rates.ns(cycle), last)
        before, last = begun, tuple(min(own) for own in zip(*states))
        for _ in range(frames):
            states = _idle(_next(states, order, found, gap), order)
            if sum(map(len, states.values())) > MOST_ORDERS:
                raise NotKnown(f"frames may come in more than {MOST_ORDERS} orders")
    raise NotKnown(f"after {passed} times {rates.ns(cycle) / 1e9:g} s the bus is still not where it was before")


def _next(states: States, order: Sequence[InUnits], found: dict[tuple[int, int], Interval], gap: int) -> States:
    """Return what may be after one frame more, and note how long it took."""
    after: States = {}
    for through, idles in states.items():
        due = [each.offset + n * each.period for each, n in zip(order, through)]
        soonest = min(at + each.jitter for at, each in zip(due, order))
        for earliest, latest in idles:
            waits = max(latest, soonest)
            last = waits  # when it begins at the latest, for all that win are not queued yet
            for i, own in enumerate(order):
                first = max(earliest, due[i])
                if first <= last:
                    end = first + own.least, last + own.length
                    job, cut = (own.place, through[i]), due[i] + gap
                    low, high = found.get(job, (end[0] - cut, end[1] - cut))
                    found[job] = min(low, end[0] - cut), max(high, end[1] - cut)
                    after.setdefault((*through[:i], through[i] + 1, *through[i + 1 :]), []).append(end)
                last = min(last, due[i] + own.jitter - 1)
    return {through: _merged(idles) for through, idles in after.items()}


def _merged(idles: list[Interval]) -> list[Interval]:
    """Return intervals with those that overlap as one."""
    if len(idles) == 1:
        return idles
    kept: list[Interval] = []
    for low, high in sorted(idles):
        if kept and low <= kept[-1][1]:
            kept[-1] = kept[-1][0], max(kept[-1][1], high)
        else:
            kept.append((low, high))
    return kept


def _idle(states: States, order: Sequence[InUnits]) -> States:
    """Return the states with the time left out in which nothing is queued: it changes nothing."""
    found = {}
    for through, idles in states.items():
        first = min(each.offset + n * each.period for each, n in zip(order, through))
        found[through] = _merged([(max(low, first), max(high, first)) for low, high in idles])
    return found


def _begun(states: States, count: Sequence[int], passed: int, cycle: int) -> States:
    """Return the states counted from the beginning of the present hyperperiod."""
    return {
        tuple(n - passed * each for n, each in zip(through, count)): [(a - passed * cycle, b - passed * cycle) for a, b in idles]
        for through, idles in states.items()
    }


def _within(now: States, before: States) -> bool:
    return all(
        any(low <= a and b <= high for low, high in before.get(through, ())) for through, idles in now.items() for a, b in idles
    )


def _closed(
    found: Mapping[tuple[int, int], Interval], order: Sequence[InUnits], count: Sequence[int], cycle_ns: int, last: Sequence[int]
) -> ResponseRanges:
    """Return the ranges; from the last hyperperiod on an instance stands for all that come again in its place."""
    ranges = dict(found)
    leads, counts = [0] * len(order), [0] * len(order)
    for own, every, first in zip(order, count, last):
        leads[own.place], counts[own.place] = first, every
        for (place, instance), (low, high) in found.items():
            if place == own.place and instance >= first:
                at = place, first + (instance - first) % every
                ranges[at] = min(ranges[at][0], low), max(ranges[at][1], high)
    return ResponseRanges(hyperperiod_ns=cycle_ns, lead=tuple(leads), count=tuple(counts), ranges=ranges)
