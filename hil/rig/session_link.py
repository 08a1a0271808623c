"""The link of a session: what it is, with the keys and CAN identifiers that the experiment names, and the faults of its bus."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct

from hil.errors import ExperimentError
from hil.experiment import Experiment
from hil.experiment.rig_tables import BIT_ERRORS
from hil.rig.can_bus import CONTROLLER, can_bus_of
from hil.rig.can_frames import CONTROL, can_faults, own_identifiers, ranges_of
from hil.rig.schedules import bus_faults
from hil.rig.spec import RigSpec
from transport.links.can_identifiers import Identifiers, said
from transport.links.opening import is_foreign
from transport.links.traits import LinkTraits, identifiers_on, traits_of, with_options

if TYPE_CHECKING:
    from transport.can_bus_model.planned_faults import BusFault


class SessionLink(Struct, frozen=True, kw_only=True):
    """The link of a session: what it is, and the CAN identifiers of a rig's packets on it.

    Args:
        uri: with the keys and identifiers that the experiment names.
        traits: what the link says that it is.
        identifiers: of the packets on a CAN link; on any other those of a CAN link by default, as an export has them. None where
            the rig has more nodes than a CAN link has identifiers for.
    """

    uri: str
    traits: LinkTraits
    identifiers: Identifiers | None

    @property
    def on_can(self) -> bool:
        """Whether it is a CAN link."""
        return self.traits.can is not None

    @property
    def unproved(self) -> bool:
        """Whether it is a plug-in of the user's own, and no code (``auth=``) says that a frame is as it was sent."""
        return is_foreign(self.uri) and not self.traits.keyed

    def first_identifiers(self) -> FirstIdentifiers | None:
        """Return with which identifier each packet begins, None where it is no CAN link."""
        own = self.identifiers
        return FirstIdentifiers(tuple(ids[0] for ids in own.sensors), own.control[0]) if self.on_can and own else None

    def said(self, rig: RigSpec) -> dict[str, dict[str, str]]:
        """Return what the log says of its frames: topic to the CAN identifiers of each talker, as ``hil dbc`` has them too."""
        own = self.identifiers
        if own is None:
            return {}
        described = {f"can_id.{sensor.name}": said(ids) for sensor, ids in zip(rig.sensors, own.sensors, strict=True)}
        return {"/link/sensor": described, "/link/control": {"can_id.control": said(own.control)}}


class FirstIdentifiers(Struct, frozen=True):
    """The CAN identifier with which each packet begins.

    Args:
        sensors: of each sensor node, by number.
        control: of the control packets.
    """

    sensors: tuple[int, ...]
    control: int


def link_of(rig: RigSpec, uri: str | None = None) -> SessionLink:
    """Return a link with the keys and identifiers that a rig names; what its URI says itself is kept.

    Args:
        rig: the rig.
        uri: another link than its own.

    Raises:
        ExperimentError: two nodes with one CAN identifier, or one of more than 11 bits.
        TransportError: no link has this URI.
    """
    uri = rig.links.secured(rig.folder, uri)
    traits = traits_of(uri)
    framing = traits.can
    if framing is None:
        return SessionLink(uri=uri, traits=traits, identifiers=_by_default(rig))
    if not framing.names_nodes and (len(rig.sensors) > 1 or own_identifiers(rig)):
        faults = can_faults(rig, traits)
        if faults:
            raise ExperimentError(rig.name, faults)
        own, more = ranges_of(rig, framing, traits.keyed), {"nodes": f"{len(rig.sensors)}"}
        if own_identifiers(rig):
            more = {"ids": ",".join(said(each) for path, each in own.items() if path != CONTROL), "control": said(own[CONTROL])}
        uri = with_options(uri, more)
    return SessionLink(uri=uri, traits=traits, identifiers=identifiers_on(uri))


def no_link(rig: RigSpec) -> SessionLink:
    """Return the link of a session in virtual time: there is none, and the log says the default identifiers of its frames."""
    return SessionLink(uri="memory:", traits=traits_of("memory:"), identifiers=_by_default(rig))


def _by_default(rig: RigSpec) -> Identifiers | None:
    try:
        return link_of(rig, "can:hil:none").identifiers
    except ExperimentError:
        return None  # more nodes than a CAN link has identifiers for


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
