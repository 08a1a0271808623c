"""Faults of the CAN bus of a link that takes time: what of a time line acts on the bus between rig and controller themselves."""

from __future__ import annotations

from hil.errors import ExperimentError
from hil.experiment import Experiment
from hil.experiment.rig_tables import BIT_ERRORS
from hil.rig.can_bus import CONTROLLER, can_bus_of
from hil.rig.schedules import bus_faults
from hil.rig.session_link import SessionLink
from hil.rig.spec import RigSpec
from transport.can_bus_model.planned_faults import BusFault

_RIG = "rig"


def refuse_undisturbed(e: Experiment, rig: RigSpec, link: SessionLink) -> None:
    """Refuse a run in which bits are to be disturbed, and there is no bus with bits.

    Raises:
        ExperimentError: the experiment has no medium of kind ``can``, and the run no link that takes time.
    """
    if can_bus_of(rig) is not None or link.traits.timed:
        return
    message = "this run has no bus whose bits could be disturbed: a link has bits in real time (--clock real) and with ?timed=1, "
    message += "a medium of kind 'can' always"
    faults = [f"fault[{i}].kind: {message}" for i, fault in enumerate(e.fault) if fault.kind == BIT_ERRORS]
    if faults:
        raise ExperimentError(e.name, faults)


def link_faults(e: Experiment, rig: RigSpec, link: SessionLink) -> list[BusFault]:
    """Return what is wrong with the bus of a link when; nothing where it takes no time, or the rig emulates a CAN bus.

    The rig is one node on it: it is off the bus when all its sensor nodes are; one of several is off at the rig alone.

    Args:
        e: the experiment.
        rig: of it.
        link: of the session.

    Returns:
        In session time, ns; `off` is 0 for the rig and 1 for the controller.
    """
    if not link.traits.timed or can_bus_of(rig) is not None:
        return []
    alone = rig.sensors[0].name if len(rig.sensors) == 1 else _RIG
    names = (alone, CONTROLLER)
    found = []
    for fault, bus_fault in zip((f for f in e.fault if f.kind in (BIT_ERRORS, "bus-off")), bus_faults(e, names, CONTROLLER)):
        found.append(bus_fault._replace(off=(0,)) if fault.link == "sc" and fault.kind == "bus-off" else bus_fault)
    return [fault for fault in found if fault.off or fault.rate is not None or fault.identifier is not None]
