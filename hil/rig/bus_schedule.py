"""Which packets a bus with arbitration carries in which slot, where the clocks of its nodes draw nothing: a cycle."""

from __future__ import annotations

from collections.abc import Sequence
from math import lcm

from hil.experiment.nodes import ClockTable
from transport.medium.medium import SampleClock
from transport.medium.scheduled import Arbitration

MOST_PHASES = 64
"""The theory takes one matrix per slot of the cycle, each on the stacked state."""

BusCycle = tuple[tuple[tuple[int, int], ...], ...]


def bus_cycle(clocks: Sequence[ClockTable], frames: int, identifiers: Sequence[int] = ()) -> BusCycle | str:
    """Return in every slot of the cycle, from slot 0, the (node, age) that the bus carries; or why there is no such cycle.

    The bus is run, by the rule that runs it in the rig, until what waits is as it was before. What is carried in the first slots
    may lack samples from before slot 0 only, which were zero and which nobody needs.

    Args:
        clocks: of all nodes, by number.
        frames: frames that the bus carries in a slot.
        identifiers: of all nodes, of which the lowest wins; by default their numbers.
    """
    order = sorted(range(len(clocks)), key=lambda node: identifiers[node] if identifiers else node)
    rank = {node: place for place, node in enumerate(order)}
    drawn = [i for i, clock in enumerate(clocks) if clock.drawn]
    if drawn:
        return f"the theory knows no bus whose nodes have clocks that draw: nodes {drawn}"
    common = lcm(*(clock.every for clock in clocks))
    if common > MOST_PHASES:
        return f"the clocks of the nodes come together every {common} slots, the theory takes cycles of {MOST_PHASES} slots"
    running, bus = [SampleClock(every=clock.every, phase=clock.phase) for clock in clocks], Arbitration(frames)
    carried: list[tuple[tuple[int, int], ...]] = []
    seen: dict[tuple[tuple[int, int], ...], int] = {}
    while True:
        k = len(carried)
        if k % common == 0:
            state = tuple(sorted((node, k - waiting.tick) for node, waiting in bus.waiting.items()))
            if state in seen:
                first = seen[state]
                break
            seen[state] = k
        for node, clock in enumerate(running):
            if clock.due(k):
                bus.offer(rank[node], k, None)
        carried.append(tuple((order[place], k - waiting.tick) for place, waiting in bus.winners()))
    period = len(carried) - first
    if period > MOST_PHASES:
        return f"the bus repeats itself every {period} slots, the theory takes cycles of {MOST_PHASES} slots"
    cycle = tuple(carried[first + (k - first) % period] for k in range(period))
    for k in range(first):
        if carried[k] != tuple((node, age) for node, age in cycle[k % period] if age <= k):
            return f"the bus needs {first} slots until it repeats itself, and the theory takes it from slot 0"
    return cycle
