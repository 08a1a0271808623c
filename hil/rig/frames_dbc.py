"""The frames of a rig in words for others: their DBC, and what a rig answers to who asks."""

from __future__ import annotations

from hil.errors import ExperimentError
from hil.rig.can_frames import can_faults, most_rows
from hil.rig.session_link import link_of
from hil.rig.spec import RigSpec
from transport.dbc import LONGEST_NAME, BusNode, dbc_text
from transport.links.link import TransportError
from transport.links.traits import CanFraming, LinkTraits


def rig_dbc(rig: RigSpec, link: str | None = None) -> str:
    """Return the DBC of a rig's frames: a message for each node and each fragment, each value by its name.

    Args:
        rig: the rig.
        link: another link than its own, whose framing and identifiers count.

    Raises:
        ExperimentError: two nodes with one CAN identifier, or one of more than 11 bits.
    """
    on = link_of(rig, link)
    own, framing, sensors = on.identifiers, on.traits.can or CanFraming(), rig.sensors
    if own is None:
        raise ExperimentError(rig.name, can_faults(rig, LinkTraits(commanders="", can=framing)))
    short = all(len(sensor.name) <= LONGEST_NAME - 12 for sensor in sensors)
    units = {signal.name: signal.unit for signal in rig.outputs}
    references = tuple((f"ref_{name}"[:LONGEST_NAME], unit) for name, unit in units.items())
    talkers = []
    for number, (sensor, identifiers) in enumerate(zip(sensors, own.sensors, strict=True)):
        outputs, name = [list(units)[i] for i in sensor.outputs], sensor.name if sensor.numbered else ""
        values = tuple((f"{output[: LONGEST_NAME - 4]}_{j}", units[output]) for j in range(sensor.buffer) for output in outputs)
        talkers.append(
            BusNode(
                name=f"Sensor_{name if short else number}_" if name else "Sensor", identifiers=identifiers,
                about=f"Node {number}{' ' + name if name else ''}: {', '.join(outputs)}, each with the number of slots before "
                "the newest sample; then the references. EMPTY: no sample arrived.",
                values=(*values, *references), references=len(references),
            )
        )  # fmt: skip
    inputs = [(signal.name, signal.unit) for signal in rig.inputs]
    rows = tuple((f"{name[: LONGEST_NAME - 5]}_{row}", unit) for row in range(most_rows(rig, framing)) for name, unit in inputs)
    talkers.append(
        BusNode(
            name="Control", identifiers=own.control, sensor=False, values=rows,
            about="Send-all packet that answers slot Seq: input, and the row behind its name; at most these rows.",
        )
    )  # fmt: skip
    return dbc_text(talkers, fd=framing.fd, title=f"{rig.name}, packets of hilrig, version 3")


def about_rig(rig: RigSpec) -> dict[str, object]:
    """Return what a rig answers to who asks: experiment, period, nodes, and the DBC, which is the layout of its frames."""
    try:
        dbc = rig_dbc(rig)
    except (TransportError, ExperimentError):
        dbc = ""  # more nodes than a CAN link has identifiers for
    nodes = [sensor.name for sensor in rig.sensors]
    return {"experiment": rig.name, "period_ns": rig.period_ns, "slots": rig.slots, "nodes": nodes, "dbc": dbc}
