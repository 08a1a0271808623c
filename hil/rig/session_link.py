"""The link of a session: what it is, with the keys and CAN identifiers that the experiment names, its frames, and its faults."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import quote
from warnings import catch_warnings

from msgspec import Struct

from hil.errors import ExperimentError, HilError
from hil.experiment import Experiment
from hil.experiment.rig_tables import BIT_ERRORS, OwnMessages
from hil.plugins.user_plugins import user_failure
from hil.rig import RigSpec
from hil.rig.can_bus import CONTROL, CONTROLLER, can_bus_of, can_faults, most_rows, own_identifiers, ranges_of
from hil.rig.schedules import bus_faults
from transport.errors import FieldError
from transport.links import Link, Role, TransportError
from transport.links.can_identifiers import Identifiers, identifiers_text
from transport.links.traits import CanFraming, LinkTraits, identifiers_on, scheme_of, traits_of, with_options

if TYPE_CHECKING:
    from transport.can_bus_model.disturbances import BusFault


LONGEST_WAIT_S: Final = 1e8
"""For a controller that is not there yet: so long is until Ctrl-C."""


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
        from transport.links.opening import is_foreign  # of real time

        return is_foreign(self.uri) and not self.traits.keyed

    @property
    def logged(self) -> Identifiers | None:
        """The identifiers, of which each packet's record says the first; None where it is no CAN link."""
        return self.identifiers if self.on_can else None

    def channel_metadata(self, rig: RigSpec) -> dict[str, dict[str, str]]:
        """Return the CAN identifiers of its frames for the log: topic to those of each sender, as in ``hil dbc``."""
        own = self.identifiers
        if own is None:
            return {}
        described = {f"can_id.{sensor.name}": identifiers_text(ids) for sensor, ids in zip(rig.sensors, own.sensors, strict=True)}
        return {"/link/sensor": described, "/link/control": {"can_id.control": identifiers_text(own.control)}}


def link_of(rig: RigSpec, uri: str | None = None, *, external: bool = False) -> SessionLink:
    """Return a link with the keys and identifiers that a rig names; what its URI says itself is kept.

    Args:
        rig: the rig.
        uri: another link than its own.
        external: whether its other end is a controller of the user's own, with messages of its own where the rig names them.

    Raises:
        ExperimentError: two nodes with one CAN identifier, or one of more than 11 bits; messages of values that the rig has not.
        TransportError: no link has this URI.
    """
    uri = rig.links.secured(rig.folder, uri)
    traits = traits_of(uri)
    if external and rig.links.messages is not None and "messages" in traits.takes:
        uri = with_options(uri, _message_options(rig, rig.links.messages))
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
            control = identifiers_text(own.pop(CONTROL))
            more = {"ids": ",".join(map(identifiers_text, own.values())), "control": control}
        uri = with_options(uri, more)
    return SessionLink(uri=uri, traits=traits, identifiers=identifiers_on(uri))


def _message_options(rig: RigSpec, own: OwnMessages) -> dict[str, str]:
    """Return the options of a link's URI that stand for messages of a controller's own.

    Raises:
        ExperimentError: they name values that the rig has not, no signal of an input, or signals that the database has not.
    """
    from transport.links.message_table import read_table  # of the few links that have them; it reads a DBC

    outputs, inputs = ({signal.name: signal.unit for signal in signals} for signals in (rig.outputs, rig.inputs))
    faults = [
        f"{table}.{name}: the plant has no such {'input' if has is inputs else 'output'} (there are: {', '.join(has)})"
        for table, has in (("outputs", outputs), ("references", outputs), ("inputs", inputs))
        for name in getattr(own, table) if name not in has
    ]  # fmt: skip
    faults += [f"inputs: no signal commands {name!r}" for name in inputs if name not in own.inputs]

    def named(signals: dict[str, str], units: dict[str, str], names: Iterable[str]) -> str:
        texts = [(name, signals.get(name, "")) for name in names]
        return ",".join(text if "*" in text or not text else f"{text}:{units[name]}" for name, text in texts)

    nodes = [[[*outputs][i] for i in sensor.outputs] for sensor in rig.sensors]
    found = {
        "dbc": str(Path(rig.folder) / own.dbc),
        "outputs": ";".join(named(own.outputs, outputs, names) for names in nodes),
        "references": named(own.references, outputs, outputs) if own.references else "",
        "inputs": named(own.inputs, inputs, inputs),
        "counters": ",".join(own.counters),
        "valid": "" if own.valid is None else repr(float(own.valid)),
    }
    try:
        if not faults:
            read_table(found)
    except FieldError as error:
        faults.append(str(error))
    if faults:
        raise ExperimentError(rig.name, [f"links.messages.{fault}" for fault in faults])
    return {option: quote(text, safe="*:;,/") for option, text in found.items() if text}


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


@contextmanager
def opened(uri: str, role: Role) -> Iterator[Link]:
    """Open one end of a link, and close it; what one of the user's own raises meanwhile is a message, SystemExit too.

    Args:
        uri, role: as of `transport.open_link`.

    Raises:
        HilError: it raised; with its own words.
        TransportError: it cannot be opened.
    """
    from transport.links.opening import open_link  # of real time

    link = open_link(uri, role)
    try:
        with link as end:
            yield end
    except HilError:
        raise
    except (Exception, SystemExit) as error:
        said = user_failure(error, (link,))
        if said is None:
            raise
        raise HilError(f"link {uri!r}: {said}") from error


def refuse_one_process(uri: str, traits: LinkTraits) -> None:
    """Refuse a link that lies within one process, where two are to be joined.

    Raises:
        HilError: it does.
    """
    if traits.one_process:
        raise HilError(f"link {uri!r}: lies within one process; expected a link between two, such as can:hil:rig0")


def refuse_unopened(link: SessionLink, *, external: bool = False) -> None:
    """Open both ends of a link and close them: what cannot be is said before anything starts.

    What is odd about it, the rig says, when it opens its end.

    Args:
        link: between the processes of a session.
        external: the controller is an external one, there already: it must not meet these ends.

    Raises:
        HilError: the link lies within one process, or an end cannot be opened or closed; with the link's own words.
    """
    if external or not link.traits.in_process:
        refuse_one_process(link.uri, link.traits)
    if external or link.traits.in_process:
        return
    try:
        with catch_warnings(action="ignore"), opened(link.uri, "rig"), opened(link.uri, "controller"):
            pass
    except TransportError as error:
        raise HilError(str(error)) from error


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


def rig_dbc(rig: RigSpec, link: str | None = None) -> str:
    """Return the DBC of a rig's frames: a message for each node and each fragment, each value by its name.

    Args:
        rig: the rig.
        link: another link than its own, whose framing and identifiers count.

    Raises:
        ExperimentError: two nodes with one CAN identifier, or one of more than 11 bits.
        TransportError: another link that there cannot be.
    """
    from transport.dbc import LONGEST_NAME, BusNode, dbc_text  # no run needs it: a hundredth of its start

    if link is not None and scheme_of(link) == "can":
        from transport.links.can_open import check_options  # of an interface but `hil` it needs python-can

        check_options(link)
    on = link_of(rig, link)
    own, framing, sensors = on.identifiers, on.traits.can or CanFraming(), rig.sensors
    if own is None:
        raise ExperimentError(rig.name, can_faults(rig, LinkTraits(commanders="", can=framing)))
    short = all(len(sensor.name) <= LONGEST_NAME - 12 for sensor in sensors)
    units = {signal.name: signal.unit for signal in rig.outputs}
    references = tuple((f"ref_{name}"[:LONGEST_NAME], unit) for name, unit in units.items())
    senders = []
    for number, (sensor, identifiers) in enumerate(zip(sensors, own.sensors, strict=True)):
        outputs, name = [list(units)[i] for i in sensor.outputs], sensor.name if sensor.numbered else ""
        values = tuple((f"{output[: LONGEST_NAME - 4]}_{j}", units[output]) for j in range(sensor.buffer) for output in outputs)
        senders.append(
            BusNode(
                name=f"Sensor_{name if short else number}_" if name else "Sensor", identifiers=identifiers,
                about=f"Node {number}{' ' + name if name else ''}: {', '.join(outputs)}, each with the number of slots before "
                "the newest sample; then the references. EMPTY: no sample arrived.",
                values=(*values, *references), references=len(references),
            )
        )  # fmt: skip
    inputs = [(signal.name, signal.unit) for signal in rig.inputs]
    rows = tuple((f"{name[: LONGEST_NAME - 5]}_{row}", unit) for row in range(most_rows(rig, framing)) for name, unit in inputs)
    senders.append(
        BusNode(
            name="Control", identifiers=own.control, sensor=False, values=rows,
            about="Send-all packet that answers slot Seq: input, and the row behind its name; at most these rows.",
        )
    )  # fmt: skip
    return dbc_text(senders, fd=framing.fd, title=f"{rig.name}, packets of hilrig, version 3")


def about_rig(rig: RigSpec) -> dict[str, object]:
    """Return what a rig announces: experiment, period, nodes, and the DBC, which is the layout of its frames."""
    try:
        dbc = rig_dbc(rig)
    except (TransportError, ExperimentError):
        dbc = ""  # more nodes than a CAN link has identifiers for
    nodes = [sensor.name for sensor in rig.sensors]
    return {"experiment": rig.name, "period_ns": rig.period_ns, "slots": rig.slots, "nodes": nodes, "dbc": dbc}
