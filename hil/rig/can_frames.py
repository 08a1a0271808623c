"""The CAN identifiers of an experiment: of each sensor node and of the controller; what is wrong with them; their DBC."""

from __future__ import annotations

from dataclasses import dataclass

from design.controllers import row_count
from hil.errors import ExperimentError
from hil.experiment.tables import Experiment
from hil.rig.sensor_list import Sensor, sensors_of
from hil.rig.sensor_order import first_identifiers, framing
from transport.dbc import LONGEST_NAME, Talker, dbc_text
from transport.links.can_identifiers import FRAGMENTS, LARGEST, Identifiers, derived, identifiers_of, said
from transport.links.link import TransportError, split_uri
from transport.wire.layout import control_length, sensor_length

CONTROL = "links.control_can_id"


def link_uri(e: Experiment, link: str | None = None) -> str:
    """Return the URI of a link with the keys and identifiers that the experiment names; what the URI says itself is kept.

    Args:
        e: the experiment.
        link: another link than its own.

    Raises:
        ExperimentError: two nodes with one CAN identifier, or one of more than 11 bits.
    """
    uri = e.links.secured(e.folder, link)
    if not uri.startswith("can:") or not (len(e.nodes) > 1 or _explicit(e)):
        return uri
    try:
        options = split_uri(uri)[2]
    except TransportError:
        return uri  # opening it says what is wrong
    if options.keys() & {"nodes", "ids"}:
        return uri
    faults = can_faults(e, uri)
    if faults:
        raise ExperimentError(e.name, faults)
    own = _ranges(e, uri)
    more = f"nodes={len(e.nodes)}"
    if _explicit(e):
        more = f"ids={','.join(said(each) for path, each in own.items() if path != CONTROL)}"
        more += "" if "control" in options else f"&control={said(own[CONTROL])}"
    return f"{uri}{'&' if options else '?'}{more}"


def can_faults(e: Experiment, uri: str | None = None) -> list[str]:
    """Return what is wrong with the CAN identifiers of an experiment, each with its path.

    Args:
        e: the experiment; its nodes may be faulty.
        uri: of a link; the experiment's own by default. One that is no CAN link is judged as CAN FD with the base 0x100.
    """
    uri = e.links.uri if uri is None else uri
    if len(e.nodes) > FRAGMENTS and any(node.can_id is None for node in e.nodes.values()):
        if not uri.startswith("can:"):
            return []
        return [f"nodes: {len(e.nodes)} of them; a CAN link has identifiers for {FRAGMENTS}, unless each names its can_id"]
    faults: list[str] = []
    owner: dict[int, str] = {}
    needed = _needed(e, uri)
    for path, own in _ranges(e, uri).items():
        frames = f"its packets take {needed[path]} frames" if needed[path] > 1 else "its packets take 1 frame"
        if own[-1] > LARGEST:
            faults.append(f"{path}: {own[0]:#x}, and {frames}: above {LARGEST:#x} (11 bits)")
        elif needed[path] > len(own):
            faults.append(f"{path}: {frames}, and its identifiers are {said(own)}; give it a can_id of its own")
        taken = next((identifier for identifier in own if identifier in owner), None)
        if taken is not None:
            whose = "the control packets" if owner[taken] == CONTROL else f"node {owner[taken].split('.')[1]!r}"
            other = "" if taken == own[0] else f" ({taken:#x}, for {frames})"
            faults.append(f"{path}: {own[0]:#x} is the identifier of {whose} already{other}")
        for identifier in own:
            owner.setdefault(identifier, path)
    return faults


def experiment_dbc(e: Experiment, link: str | None = None) -> str:
    """Return the DBC of an experiment's frames: a message for each node and each fragment, each value by its name.

    Args:
        e: the experiment.
        link: another link than its own, whose framing and identifiers count.

    Raises:
        ExperimentError: two nodes with one CAN identifier, or one of more than 11 bits.
    """
    uri = link_uri(e, link)
    own, (_, fd) = identifiers_on(e, uri), framing(uri)
    sensors = sensors_of(e)
    short = all(len(sensor.name) <= LONGEST_NAME - 12 for sensor in sensors)
    units = {signal.name: signal.unit for signal in e.plant.outputs}
    references = tuple((f"ref_{name}"[:LONGEST_NAME], unit) for name, unit in units.items())
    talkers = []
    for number, (sensor, identifiers) in enumerate(zip(sensors, own.sensors, strict=True)):
        outputs, name = [list(units)[i] for i in sensor.outputs], sensor.name if sensor.numbered else ""
        values = tuple((f"{output[: LONGEST_NAME - 4]}_{j}", units[output]) for j in range(sensor.buffer) for output in outputs)
        talkers.append(
            Talker(
                name=f"Sensor_{name if short else number}_" if name else "Sensor", identifiers=identifiers,
                about=f"Node {number}{' ' + name if name else ''}: {', '.join(outputs)}, each with the number of slots before "
                "the newest sample; then the references. EMPTY: no node is heard.",
                values=(*values, *references), references=len(references),
            )
        )  # fmt: skip
    inputs = [(signal.name, signal.unit) for signal in e.plant.inputs]
    rows = tuple((f"{name[: LONGEST_NAME - 5]}_{row}", unit) for row in range(_rows(e, uri)) for name, unit in inputs)
    talkers.append(
        Talker(
            name="Control", identifiers=own.control, sensor=False, values=rows,
            about="Send-all packet that answers slot Seq: input, and the row behind its name; at most these rows.",
        )
    )  # fmt: skip
    return dbc_text(talkers, fd=fd, title=f"{e.name}, packets of hilrig, version 3")


def identifiers_on(e: Experiment, uri: str) -> Identifiers:
    """Return the identifiers of an experiment's packets on a CAN link, as its URI says them, or as they are by default.

    Raises:
        TransportError: options that say none.
    """
    return identifiers_of_link(uri if uri.startswith("can:") else link_uri(e, "can:hil:none"))


def identifiers_of_link(uri: str) -> Identifiers:
    """Return the identifiers of the packets on a CAN link, as its URI says them, or those of one node.

    Raises:
        TransportError: options that say none.
    """
    return identifiers_of(uri, split_uri(uri)[2], framing(uri)[1])


def about_rig(e: Experiment) -> dict[str, object]:
    """Return what a rig tells whoever asks: experiment, period, nodes, and the DBC, which is the layout of its frames."""
    try:
        dbc = experiment_dbc(e)
    except (TransportError, ExperimentError):
        dbc = ""  # more nodes than a CAN link has identifiers for
    nodes = [sensor.name for sensor in sensors_of(e)]
    return {"experiment": e.name, "period_ns": e.period_ns, "slots": e.ticks, "nodes": nodes, "dbc": dbc}


def said_identifiers(e: Experiment, uri: str) -> dict[str, dict[str, str]]:
    """Return what the log says of its frames: topic to the CAN identifiers of each talker, as ``hil dbc`` has them too.

    Args:
        e: the experiment.
        uri: the link of the session; one that is no CAN link has the default identifiers of its nodes, as an export has.
    """
    try:
        own = identifiers_on(e, uri)
    except (TransportError, ExperimentError):
        return {}  # more nodes than a CAN link has identifiers for
    told = {f"can_id.{sensor.name}": said(ids) for sensor, ids in zip(sensors_of(e), own.sensors, strict=True)}
    return {"/link/sensor": told, "/link/control": {"can_id.control": said(own.control)}}


@dataclass(frozen=True, slots=True)
class FirstIdentifiers:
    """The CAN identifier with which each packet begins.

    Args:
        sensors: of each sensor node, by number.
        control: of the control packets.
    """

    sensors: tuple[int, ...]
    control: int


def session_identifiers(e: Experiment, uri: str) -> FirstIdentifiers | None:
    """Return the identifiers of the packets of a session, None where its link is no CAN link.

    Args:
        e: the experiment.
        uri: the link of the session.

    Raises:
        TransportError: options that say none.
    """
    if not uri.startswith("can:"):
        return None
    own = identifiers_on(e, uri)
    return FirstIdentifiers(tuple(ids[0] for ids in own.sensors), own.control[0])


def _path(sensor: Sensor) -> str:
    return f"{sensor.path}.can_id" if sensor.numbered else sensor.path  # links.sc has no key for it


def _explicit(e: Experiment) -> bool:
    return e.links.control_can_id is not None or any(node.can_id is not None for node in e.nodes.values())


def _ranges(e: Experiment, uri: str) -> dict[str, range]:
    """Return path to identifiers; where some are set, all take as many as their packets have frames."""
    (base, fd), paths = framing(uri), [_path(sensor) for sensor in sensors_of(e)]
    below = derived(base, fd, len(paths)) if len(paths) <= FRAGMENTS else derived(base, fd)
    if not _explicit(e):
        return dict(zip((*paths, CONTROL), (*below.sensors, below.control), strict=True))
    first = dict(zip(paths, first_identifiers(e, uri), strict=True))
    first[CONTROL] = below.control[0] if e.links.control_can_id is None else e.links.control_can_id
    return {path: range(start, start + _needed(e, uri)[path]) for path, start in first.items()}


def _needed(e: Experiment, uri: str) -> dict[str, int]:
    """Return path to the frames of its longest packet."""
    step, tagged, outputs = 64 if framing(uri)[1] else 8, e.links.auth is not None or "auth=" in uri, len(e.plant.outputs)
    values = {_path(sensor): len(sensor.outputs) * sensor.buffer for sensor in sensors_of(e)}
    needed = {path: -(-sensor_length(own + outputs, tagged) // step) for path, own in values.items()}
    control = control_length(_rows(e, uri) * len(e.plant.inputs), tagged)
    return needed | {CONTROL: min(-(-control // step), FRAGMENTS)}


def _rows(e: Experiment, uri: str) -> int:
    """Return the most rows that an answer may have, whatever the rule, or that its frames hold."""
    room = FRAGMENTS * (64 if framing(uri)[1] else 8) - control_length(0)
    return min(row_count("both", e.links.ca.max_age), room // (4 * len(e.plant.inputs)))
