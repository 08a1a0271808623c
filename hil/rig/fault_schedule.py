"""The faults on the time line of an experiment: what is wrong with them, and what they break in which slots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hil.experiment import Experiment
from hil.experiment.faults import RESTART, Fault
from transport.medium.faulted import FaultInterval


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultSchedule:
    """What is broken when.

    Args:
        nodes: of each sensor node, by number.
        actuator: of the way from the controller to the actuator.
        restarts: first slot of each restart of the controller, and the one in which it may answer again.
    """

    nodes: tuple[tuple[FaultInterval, ...], ...]
    actuator: tuple[FaultInterval, ...]
    restarts: tuple[tuple[int, int], ...]


def fault_schedule_faults(e: Experiment) -> list[str]:
    """Return what is wrong with the time line, each with its path."""
    there = f"there are: {', '.join(e.network.nodes)}" if e.network.nodes else "no node is named: use link"
    return [
        f"fault[{i}].node: there is no node {fault.node!r} ({there})"
        for i, fault in enumerate(e.fault)
        if fault.node is not None and fault.node not in e.network.nodes
    ]


def beyond_the_end(e: Experiment) -> str:
    """Return what of its time line a run never reaches, in words; empty where it reaches all.

    Args:
        e: a checked experiment.

    >>> from hil.experiment import load_experiment
    >>> late = "fault=[{at=9,for=1,kind='cut',link='sc'}]"
    >>> beyond_the_end(load_experiment("dc-motor-hinf", ["duration=5", late]))
    'fault[0].at: 9 s lies beyond the end of the run (5 s): the cut of network.sc for 1 s never happens'
    """
    return "; ".join(
        f"fault[{i}].at: {fault.at:g} s lies beyond the end of the run ({e.duration:g} s): the {told(fault)} never happens"
        for i, fault in enumerate(e.fault)
        if fault.slots(float(e.period))[0] >= e.slots
    )


def fault_schedule(e: Experiment, names: Sequence[str]) -> FaultSchedule:
    """Return the time line of a checked experiment. A controller that is off the bus hears nothing either.

    Args:
        e: the experiment.
        names: of the sensor nodes, by number.
    """
    nodes: list[list[FaultInterval]] = [[] for _ in names]
    actuator: list[FaultInterval] = []
    restarts = []
    for fault in e.fault:
        first, end = fault.slots(float(e.period))
        if fault.kind == RESTART:
            restarts.append((first, end))
            continue
        spell = FaultInterval(first, end, fault.kind)
        if fault.link == "ca":
            actuator.append(spell)
        for i, name in enumerate(names):
            if fault.link == "sc" or fault.node == name or (fault.link == "ca" and fault.kind == "bus-off"):
                nodes[i].append(spell)
    return FaultSchedule(nodes=tuple(map(tuple, nodes)), actuator=tuple(actuator), restarts=tuple(sorted(restarts)))


def told(fault: Fault) -> str:
    """Return what a fault is, in words.

    >>> from hil.experiment import Seconds
    >>> told(Fault(at=Seconds(3), lasts=Seconds(0.5), kind="cut", link="ca"))
    'cut of network.ca for 0.5 s'
    """
    words = {"corrupt": "flipped bits on", "freeze": "frozen values on", "bus-off": "bus-off of", RESTART: "restart of"}
    return f"{words.get(fault.kind, f'{fault.kind} of')} {fault.where} for {fault.lasts:g} s"
