"""What happens in which slot of a rig: signals that change, a reference, a disturbance; and the faults on its time line."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

from hil.errors import nearest
from hil.experiment import Experiment
from hil.experiment.rig_tables import BIT_ERRORS, RESTART, Fault
from transport.medium import LOSES, FaultInterval

if TYPE_CHECKING:
    from hil.rig import RigSpec
    from transport.can_bus_model.disturbances import BusFault


SCHEDULES: Final = ("reference", "disturbance")
"""Tables of a time line that are no part of what is certified, but from where it begins."""


class FaultSchedule(Struct, frozen=True, kw_only=True):
    """What is broken when.

    Args:
        nodes: of each sensor node, by number.
        actuator: of the way from the controller to the actuator.
        restarts: first slot of each restart of the controller, and the one in which it may answer again.
    """

    nodes: tuple[tuple[FaultInterval, ...], ...]
    actuator: tuple[FaultInterval, ...]
    restarts: tuple[tuple[int, int], ...]


def fault_schedule_faults(e: Experiment, on_bus: Sequence[str] = (), *, timed_link: bool = False) -> list[str]:
    """Return what is wrong with the time line, each with its path.

    Args:
        e: the experiment.
        on_bus: names of the nodes on its CAN bus with time; none where it has no such bus.
        timed_link: whether its link is one, too.
    """
    none = "there is no CAN bus with time, whose bits could be disturbed; give the experiment a medium of kind 'can', or "
    none += "links.uri = 'can:hil:rig0?timed=1&bitrate=500k' in real time"
    there_is = bool(on_bus) or timed_link
    bits = [f"fault[{i}].kind: {none}" for i, fault in enumerate(e.fault) if fault.kind == BIT_ERRORS and not there_is]
    there = f"there are: {', '.join(e.network.nodes)}" if e.network.nodes else "no node is named: use link"
    return bits + [
        f"fault[{i}].node: there is no node {fault.node!r}{nearest(fault.node, e.network.nodes)} ({there})"
        for i, fault in enumerate(e.fault)
        if fault.node is not None and fault.node not in e.network.nodes and not (fault.kind == "bus-off" and fault.node in on_bus)
    ]


def bus_faults(e: Experiment, on_bus: Sequence[str], controller: str) -> list[BusFault]:
    """Return the faults of the CAN bus of an experiment.

    Args:
        e: checked.
        on_bus: names of the nodes on the bus, by number.
        controller: name of the one that sends the control packets.
    """
    from transport.can_bus_model.disturbances import BusFault  # loaded where there is a bus

    found = []
    for fault in e.fault:
        first, end = (k * e.period_ns for k in fault.slots(float(e.period)))
        if fault.kind == BIT_ERRORS:
            found.append(BusFault(first, end, fault.rate, fault.can_id))
        elif fault.kind == "bus-off":
            named = {"sc": tuple(e.network.nodes), "ca": (controller,), None: (fault.node,)}[fault.link]
            found.append(BusFault(first, end, off=tuple(i for i, name in enumerate(on_bus) if name in named)))
    return found


def beyond_the_end(e: Experiment) -> str:
    """Return which faults of its time line a run never reaches, a sentence; empty where it reaches all.

    Args:
        e: a checked experiment.

    >>> from hil.experiment import load_experiment
    >>> late = "fault=[{at=9,for=1,kind='cut',link='sc'}]"
    >>> beyond_the_end(load_experiment("dc-motor-hinf", ["duration=5", late]))
    'fault[0].at: 9 s lies beyond the end of the run (5 s): the cut of network.sc for 1 s never happens'
    """
    return "; ".join(
        f"fault[{i}].at: {fault.at:g} s lies beyond the end of the run ({e.duration:g} s): the {fault.text} never happens"
        for i, fault in enumerate(e.fault)
        if fault.slots(float(e.period))[0] >= e.slots
    )


def whole_again(e: Experiment, rig: RigSpec, ages: tuple[int, int, int]) -> float | str:
    """Return from when on the last fault of a checked experiment has no more effect, s; or the reason why that is unknown.

    The watchdog looks at the way to the actuator alone, see `starves`: a controller that gets no sample answers all the same.

    Args:
        e: the experiment.
        rig: its rig.
        ages: smallest and largest age of a command that the network law draws, and the largest that a packet has rows for.

    >>> from hil.experiment import load_experiment
    >>> from hil.rig import rig_of
    >>> cut = "fault=[{at=3,for=0.5,kind='cut',link='ca'}]"
    >>> for slots in (12, 11):
    ...     e = load_experiment("dc-motor-hinf", [cut, f"limits.watchdog_slots={slots}"])
    ...     whole_again(e, rig_of(e), (0, 1, 1))
    3.5
    'network.ca may bring no command for 11 slots from slot 60 on, and the watchdog trips after 11'
    """
    over = 0
    for i, fault in enumerate(e.fault):
        first, end = fault.slots(float(e.period))
        if first >= e.slots:
            continue
        why = "it lasts to the end of the run" if end >= e.slots else outlasts(fault, rig)
        if why:
            return f"of fault[{i}], the {fault.text}, {why}"
        over = max(over, end)
    for first, slots in starves(no_commands(e, *ages[:2]), *ages):
        if slots >= e.limits.watchdog_slots:
            said = f"network.ca may bring no command for {slots} slots from slot {first} on"
            return f"{said}, and the watchdog trips after {e.limits.watchdog_slots}"
    return over * float(e.period)


def outlasts(fault: Fault, rig: RigSpec) -> str:
    """Return the reason why the effect of a fault may last for any time behind its end; empty: it does not.

    Args:
        fault: of the time line.
        rig: what it breaks.
    """
    if fault.kind == BIT_ERRORS or (fault.kind == "bus-off" and any(shared.table.kind == "can" for shared in rig.media)):
        return "error counters and queues are left, and no analysis bounds how late frames are then"
    for sensor in rig.sensors:
        if sensor.trigger.kind != "every-slot" and _reaches(fault, sensor.name):
            return f"{sensor.path}.trigger knows nothing: it may keep the node silent for any time, while what it sent is missing"
    return ""


def _reaches(fault: Fault, node: str) -> bool:
    """Return whether the controller gets other samples of a node by a fault, or forgets them."""
    off_bus = fault.link == "ca" and fault.kind == "bus-off"  # a controller that is off the bus receives nothing either
    return fault.link == "sc" or fault.node == node or off_bus or fault.kind == RESTART


def no_commands(e: Experiment, youngest: int = 0, oldest: int = 0) -> list[tuple[int, int]]:
    """Return first slot and end of every time in which no command arrives, by a cut or as none was sent.

    Args:
        e: a checked experiment.
        youngest, oldest: ages that the network law draws. Of those that were sent up to slot f one may come until f + oldest, and
            of those from slot g on one may come in slot g + youngest.
    """
    intervals = []
    for fault in e.fault:
        first, end = fault.slots(float(e.period))
        if first < e.slots and fault.link == "ca" and fault.kind in LOSES:
            intervals.append((first, end))
        if first < min(end, e.slots) and (fault.kind == RESTART or (fault.link == "ca" and fault.kind == "bus-off")):
            intervals.append((first + oldest, end + youngest))
    return intervals


def starves(cuts: Sequence[tuple[int, int]], youngest: int, oldest: int, d_max: int) -> list[tuple[int, int]]:
    """Return from which slots on, and for how many, an actuator may have no command that its rows cover.

    Before a cut it holds one of age `oldest` at most, until that is older than `d_max`. One that came in the cut is lost, and the
    law may draw it again behind the end of the cut, until it is older than `oldest`.

    Args:
        cuts: first slot of each, and the one in which it is over, see `no_commands`; they may overlap.
        youngest, oldest: ages that the law draws.
        d_max: largest age that rows cover.

    >>> starves([(60, 70)], 0, 1, 1), starves([(60, 70)], 0, 0, 1), starves([(60, 65), (66, 70)], 0, 1, 1)
    ([(60, 11)], [(61, 9)], [(60, 11)])
    """
    whole = as_one(cuts, oldest - youngest)
    begins = [(max(first, oldest + 1) + d_max - oldest, end + oldest - youngest) for first, end in whole]
    return [(first, end - first) for first, end in begins if end > first]


def as_one(cuts: Sequence[tuple[int, int]], gap: int = 0) -> list[tuple[int, int]]:
    """Return cuts in order, those with at most `gap` slots between them merged: in so few slots no command need have come."""
    whole: list[tuple[int, int]] = []
    for first, end in sorted(cuts):
        if whole and first <= whole[-1][1] + gap:
            whole[-1] = whole[-1][0], max(whole[-1][1], end)
        else:
            whole.append((first, end))
    return whole


def fault_schedule(e: Experiment, names: Sequence[str]) -> FaultSchedule:
    """Return the time line of a checked experiment.

    Args:
        e: the experiment.
        names: of the sensor nodes, by number.
    """
    nodes: list[list[FaultInterval]] = [[] for _ in names]
    actuator: list[FaultInterval] = []
    restarts = []
    for fault in e.fault:
        first, end = fault.slots(float(e.period))
        if fault.kind == BIT_ERRORS:
            continue  # the bus itself
        if fault.kind == RESTART:
            restarts.append((first, end))
            continue
        interval = FaultInterval(first, end, fault.kind)
        if fault.link == "ca":
            actuator.append(interval)
        for i, name in enumerate(names):
            if _reaches(fault, name):
                nodes[i].append(interval)
    return FaultSchedule(nodes=tuple(map(tuple, nodes)), actuator=tuple(actuator), restarts=tuple(sorted(restarts)))


def disturbance_changes(e: Experiment) -> dict[int, tuple[float, ...]]:
    """Return the disturbance at the inputs of a checked experiment, by the slot from which on it is so large.

    Pulses that overlap add up, each sum rounded once: it depends neither on their order nor on what is over.
    """
    from fractions import Fraction  # loaded where there is a disturbance

    turns: dict[int, Any] = {}
    for pulse in e.disturbance:
        first, exact = round(pulse.at / e.period), np.array([Fraction(each) for each in pulse.value])
        for slot, turn in ((first, exact), (first + pulse.samples, -exact)):
            turns[slot] = turns.get(slot, 0) + turn
    slots = sorted(turns)
    return {slot: tuple(map(float, now)) for slot, now in zip(slots, accumulate(turns[slot] for slot in slots))}


class Piecewise:
    """Values by slot: that of the last change.

    Args:
        start: value until the first change.
        changes: slot to the value from there on.

    >>> signal = Piecewise((0.0,), {2: (1.0,)})
    >>> [signal.at(k) for k in range(4)]
    [(0.0,), (0.0,), (1.0,), (1.0,)]
    """

    def __init__(self, start: tuple[float, ...], changes: Mapping[int, tuple[float, ...]]) -> None:
        self._edges = sorted(changes)
        self._values = [start, *(changes[k] for k in self._edges)]

    def at(self, k: int) -> tuple[float, ...]:
        """Return the value in slot k."""
        return self._values[bisect_right(self._edges, k)]
