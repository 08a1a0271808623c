"""The topics of a run, and their registry: every other module of this folder gives its `TOPICS`. A new topic is one file here.

Writer, reader, live view, layouts, export, measures and pages ask here for names, schemas and plots. A reader asks a run for the
topics that it needs (`hil.log.run.Run.needs`): a log from before a topic was there is read as ever.

The plant gives its states, its outputs and the reference that these follow; the network what it decided about every packet, in
each direction; the link every frame, with its CAN identifier where there is one; the controller every row of the send-all packet,
and what it was computed from; the actuator node what it applied, and what its passivity controller did. A CAN bus that takes time
is described in the terms of FMI-LS-BUS 1.0: each frame from its Transmit to Confirm or Bus Error. A link alone has the frames and
the round trips of `hil probe`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import chain
from pkgutil import iter_modules
from re import findall
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from hil.errors import located, nearest
from hil.log import PACKET_SLOT, SLOT, Curve, Logged, MissingTopic, Topic, f64, floats, i32, i64, u8
from hil.log.records import STATUS, Channel, Field, Schema

if TYPE_CHECKING:
    from hil.rig.loop import Loop


def _states(names: Sequence[str], outputs: Sequence[str]) -> list[Curve]:
    return [Curve(panel=name, field=name, place=1) for name in names]


def _outputs(names: Sequence[str], outputs: Sequence[str]) -> list[Curve]:
    return [Curve(panel=name, field=name, place=0) for name in names if name in outputs]


STATE = Topic(
    name="/plant/state", schema="PlantState", filled_by="rig, every slot", since="0.1.0", paged=True,
    fields=lambda logged: (*floats(logged.states), SLOT), curves=_states,
)  # fmt: skip
MEASUREMENT = Topic(
    name="/plant/measurement", schema="PlantMeasurement", filled_by="rig, every slot", since="0.1.0", paged=True,
    fields=lambda logged: (*floats(logged.outputs), SLOT), curves=_outputs,
)  # fmt: skip
REFERENCE = Topic(
    name="/reference", schema="Reference", filled_by="rig, every slot", since="0.1.0", paged=True,
    fields=lambda logged: (*floats(logged.outputs), SLOT), curves=_outputs,
)  # fmt: skip


_DRAW: tuple[Field, ...] = (
    f64("latency_s", "s", "drawn latency, NaN for an age law"), SLOT, PACKET_SLOT,
    i32("mode", "1", "mode of the law"), i32("age", "samples", "age of the newest packet, -1 if none"),
    u8("reason", "code of the fate, names in the metadata"),
)  # fmt: skip
_NODE_DRAW = (*_DRAW[:-1], i32("node", "1", "number of the sensor node"), _DRAW[-1])
_AGE = (Curve(panel="network, age in samples", field="age", place=5),)

SC = Topic(
    name="/network/sc", filled_by="rig, every decision of the medium", since="0.1.0", paged=True,
    schema=lambda logged: "NodeDraw" if logged.numbered else "NetworkDraw",
    fields=lambda logged: _NODE_DRAW if logged.numbered else _DRAW, curves=lambda names, outputs: _AGE,
)  # fmt: skip
CA = Topic(
    name="/network/ca", filled_by="rig, every decision of the medium", since="0.1.0", paged=True,
    schema="NetworkDraw", fields=lambda logged: _DRAW, curves=lambda names, outputs: _AGE,
)  # fmt: skip


_CAN_ID = i32("can_id", "1", "CAN identifier of the frame, of the first one where several carry the packet")
_FRAME = (u8("late", "came after the deadline"), Field(type="uint8[]", name="data", doc="bytes on the link"))


def _frame_schema(logged: Logged) -> str:
    return "CanFrame" if logged.on_can else "LinkFrame"


def _frame_fields(logged: Logged) -> tuple[Field, ...]:
    return (SLOT, *((_CAN_ID,) if logged.on_can else ()), *_FRAME)


SENSOR = Topic(
    name="/link/sensor", schema=_frame_schema, fields=_frame_fields, filled_by="rig, every sensor frame",
    since="0.1.0", paged=True, frames=True,
)  # fmt: skip
CONTROL = Topic(
    name="/link/control", schema=_frame_schema, fields=_frame_fields, filled_by="rig, every control frame",
    since="0.1.0", paged=True, frames=True,
)  # fmt: skip


def _row_fields(logged: Logged) -> tuple[Field, ...]:
    u = floats(logged.inputs)
    rows = (Field(type="float64", name=f"row{i}_{f.name}", unit=f.unit) for i in range(max(logged.n_rows, 1)) for f in u)
    return (
        *rows, i64("sample_ns", "ns", "nominal time of the sample that was used"),
        i64("control_ns", "ns", "when the controller answered"), SLOT,
        i32("tau", "samples", "sensor delay that the controller measured"),
        i32("selection", "1", "code of the selection rule"),
    )  # fmt: skip


ROWS = Topic(
    name="/controller/rows", schema="ControllerRows", filled_by="rig, when an answer arrives", since="0.1.0", paged=True,
    fields=_row_fields, curves=lambda names, outputs: [Curve(panel="delays, samples", field="tau", place=3)],
)  # fmt: skip


def inputs_among(names: Sequence[str]) -> list[str]:
    """Return the inputs among the float fields of `/actuator/applied`: beside every `x` stands its disturbance, `w_x`."""
    return [name for name in names if not (name.startswith("w_") and name[2:] in names)]


def _inputs(names: Sequence[str], outputs: Sequence[str]) -> list[Curve]:
    inputs = ((name, field) for name in inputs_among(names) for field in (name, f"w_{name}") if field in names)
    own = [Curve(panel=name, field=field, place=2) for name, field in inputs]
    return [*own, Curve(panel="delays, samples", field="d", place=4)]


APPLIED = Topic(
    name="/actuator/applied", schema="ActuatorApplied", filled_by="rig, every slot", since="0.1.0", paged=True,
    fields=lambda logged: (
        *(u := floats(logged.inputs)), *(replace(f, name=f"w_{f.name}", doc="input disturbance") for f in u), SLOT, PACKET_SLOT,
        i32("d", "samples", "age of the packet at the actuator"), i32("row", "1", "index of the row that was applied"),
        u8("status", ", ".join(STATUS)),
    ),
    curves=_inputs,
)  # fmt: skip
PASSIVITY = Topic(
    name="/actuator/passivity", schema="ActuatorPassivity", filled_by="rig, with limits.passivity", since="0.2.0",
    logged=lambda logged: logged.passivity, paged=True,
    fields=lambda logged: (
        f64("energy", "J", "given by the motor beyond what damping takes"),
        f64("damping", "1", "injected, force per speed of the device"),
        f64("force", floats(logged.inputs)[0].unit if logged.inputs else "1", "injected on top of the command"), SLOT,
    ),
)  # fmt: skip


TIMING = Topic(
    name="/timing/slot", schema="SlotTiming", filled_by="rig process, in real time", since="0.1.0", paged=True,
    fields=lambda logged: (
        f64("lateness_us", "us", "wake-up after the nominal time"),
        f64("round_trip_us", "us", "sensor frame out to control frame in, NaN if none came"),
        f64("work_us", "us", "time spent in the slot, waiting excluded"), SLOT,
        u8("late", "no packet before the deadline"), u8("overrun", "the slot ended after its period"),
    ),
    curves=lambda names, outputs: [Curve(panel="timing, us", field=name, place=6) for name in ("lateness_us", "round_trip_us")],
)  # fmt: skip

EXTENDED, REMOTE, FD, SWITCH = 1, 2, 4, 8
"""Bits of ``/link/bus.flags``."""

BUS = Topic(
    name="/link/bus", schema="BusFrame", filled_by="rig, every frame on the emulated CAN bus", since="0.1.0",
    paged=True, logged=lambda logged: logged.bus,
    fields=lambda logged: (
        i64("queued_ns", "ns", "session time of Transmit: since when it waited"),
        i64("start_ns", "ns", "session time of its start of frame"),
        i64("end_ns", "ns", "session time of the end of its EOF or of the error delimiter"),
        i64("idle_ns", "ns", "session time at which the bus is idle again"), SLOT,
        i32("can_id", "1", "identifier, 11 or 29 bits"),
        i32("node", "1", "number of the node that sent it: nodes of the rig, controller, actuator, others"),
        i32("lost", "1", "arbitrations that it has lost (Arbitration Lost)"),
        i32("error_bit", "1", "bit of the frame that was disturbed, -1 if none"),
        i32("tec", "1", "transmit error counter of its node"),
        u8("operation", "0 Confirm, 1 Bus Error"), u8("flags", "1 extended, 2 remote, 4 CAN FD, 8 bit-rate switch"),
        u8("length", "bytes of data"),
    ),
)  # fmt: skip

PROBE = Topic(
    name="/probe/packet", schema="ProbePacket", filled_by="hil probe", since="0.1.0",
    logged=lambda logged: False,  # no session has it
    fields=lambda logged: (
        i64("sent_ns", "ns", "sensor frame out, since the first one"),
        i64("answered_ns", "ns", "when the other end answered, by its clock, since that instant of ours; 0 if never"),
        i64("received_ns", "ns", "control frame in, 0 if none came"), SLOT,
    ),
)  # fmt: skip
_OF_A_RUN = (STATE, MEASUREMENT, REFERENCE, APPLIED, ROWS, SC, CA, SENSOR, CONTROL, TIMING, PASSIVITY, BUS, PROBE)


def _registered() -> dict[str, Topic]:
    others = [import_module(module.name).TOPICS for module in iter_modules(__path__, f"{__name__}.")]
    return {topic.name: topic for topic in chain(_OF_A_RUN, *others)}


TOPICS: Final = _registered()
"""Name to topic, in the order of a log."""

FRAME_TOPICS: Final = tuple(topic.name for topic in TOPICS.values() if topic.frames)
"""Topics whose records are frames of the link."""

NUMBER_TOPICS: Final = tuple(topic.name for topic in TOPICS.values() if not topic.frames)
"""Topics whose records are numbers: what a measure may ask for in a sweep."""


def channels(logged: Logged) -> dict[str, Channel]:
    """Return every signal topic of a session, in the order of their numbers (``/events`` stands apart).

    Raises:
        HilError: if a signal's name cannot be a field, or two signals of one topic would share a field.
    """
    found = {}
    for number, topic in enumerate((each for each in TOPICS.values() if each.logged(logged)), 1):
        with located(f"log topic {topic.name}", ValueError, advice="signals need names that differ"):
            schema = Schema(name=topic.schema_name(logged), fields=topic.fields(logged))
        found[topic.name] = Channel(id=number, topic=topic.name, schema=schema)
    return found


def channels_of(loop: Loop, *, on_can: bool = False) -> dict[str, Channel]:
    """Return the topics that a run of a composed loop logs.

    Args:
        loop: the loop.
        on_can: the link of the session is a CAN link.
    """
    rig = loop.rig
    return channels(Logged(
        states=rig.states, inputs=rig.inputs, outputs=rig.outputs, n_rows=loop.rows, numbered=rig.numbered,
        passivity=rig.passivity, on_can=on_can, bus=any(shared.table.kind == "can" for shared in rig.media),
    ))  # fmt: skip


def in_log_of(versions: Mapping[str, str], topic: str) -> bool:
    """Return whether the hilrig that wrote a log knew a topic; one that does not say its version knew all.

    >>> in_log_of({"hilrig": "0.2.0"}, "/plant/state"), in_log_of({"hilrig": "0.0.9"}, "/plant/state")
    (True, False)
    """
    wrote, since = (tuple(map(int, findall(r"\d+", text)[:3])) for text in (versions.get("hilrig", ""), TOPICS[topic].since))
    return not wrote or wrote >= since


def missing(topic: str, there: Sequence[str]) -> MissingTopic:
    """Return the error of a reader that needs a topic which a log lacks."""
    known = TOPICS.get(topic)
    about = "" if known is None else f"; it is written by the {known.filled_by}, since hilrig {known.since}"
    hint = nearest(topic, there) if known is None else ""
    return MissingTopic(f"topic {topic}: this log lacks it{about}{hint or ';'} it has {', '.join(there) or 'none'}")


def panels(schemas: Mapping[str, Schema], topics: Sequence[str] | None = None) -> dict[str, list[tuple[str, Curve]]]:
    """Return the plots over time of a log: title to the curves in it, each with its topic.

    Args:
        schemas: topic to schema, of a log or of an experiment's channels.
        topics: only these; all by default.
    """
    measured = schemas.get(MEASUREMENT.name)
    outputs = [] if measured is None else measured.floats
    curves = [
        (name, curve)
        for name, topic in TOPICS.items() if name in schemas and (topics is None or name in topics)
        for curve in topic.curves(schemas[name].floats, outputs)
    ]  # fmt: skip
    found: dict[str, list[tuple[str, Curve]]] = {}
    for name, curve in sorted(curves, key=lambda each: each[1].place):
        found.setdefault(curve.panel, []).append((name, curve))
    return found
