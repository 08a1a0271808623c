"""Logs in MCAP: topics and their schemas, what is written while a run goes on, what is read afterwards.

A topic is one object that writer, reader, live view, layouts, export, measures and pages read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from msgspec import Struct

from hil.errors import HilError
from hil.log.records import Field, field_name
from plants.parts import Signal


class Logged(Struct, frozen=True, kw_only=True):
    """What the topics of a session depend on.

    Args:
        states, inputs, outputs: the plant's signals, n, m and p of them, each with ``name`` and ``unit``.
        n_rows: rows of the longest control packet that the selection rule can demand.
        numbered: what the network decided about a sensor packet says of which node it is.
        passivity: the rig has a passivity controller: what it measured and did is logged.
        on_can: the link of the session is a CAN link: frames have identifiers.
        bus: the emulated network has a CAN bus that takes time.
    """

    states: Sequence[Signal] = ()
    inputs: Sequence[Signal] = ()
    outputs: Sequence[Signal] = ()
    n_rows: int = 0
    numbered: bool = False
    passivity: bool = False
    on_can: bool = False
    bus: bool = False


class SlotRecord(Struct, frozen=True, kw_only=True):
    """What the rig knows at the end of a slot, for topics that are filled from it.

    Args:
        k: the slot; `t_ns` its nominal instant.
        state, y, r: plant states (n,), outputs (p,) and reference (p,) in slot k.
        u, w: input that was applied and disturbance on top, (m,) each.
        d, row, status: age of the packet at the actuator in samples, index of the row, index in `hil.log.records.STATUS`.
        frames: sensor frames of the slot.
        answer: control frame of the slot, empty if none came in time.
    """

    k: int
    t_ns: int
    state: Sequence[float]
    y: Sequence[float]
    r: Sequence[float]
    u: Sequence[float]
    w: Sequence[float]
    d: int
    row: int
    status: int
    frames: Sequence[bytes]
    answer: bytes


class Curve(Struct, frozen=True, kw_only=True):
    """One field of a topic in a plot over time; curves of one panel, also of several topics, are drawn together.

    Args:
        panel: title of the plot.
        field: name of the field.
        place: panels and curves of a smaller place stand first.
    """

    panel: str
    field: str
    place: int = 9


class Topic(Struct, frozen=True, kw_only=True):
    """A topic of the log.

    Args:
        name: of the channel, such as ``/plant/state``.
        schema: name of its record, ``CamelCase``; a function where it depends on the session.
        fields: its fields with their units, ordered float64, int64, int32, uint8, uint8[].
        filled_by: which part of a session writes its records, in words.
        since: the version of hilrig whose logs have it first.
        logged: whether a session has it.
        values: its record of a slot, the values of its fields, None for no record; only for a topic that no part of the rig
            fills by itself.
        curves: how it is plotted, from the names of its float fields and those of the plant's outputs.
        paged: a section of the page draws it; otherwise the page has a panel of its `curves`.
        frames: its records are frames of the link, and a CAN log is made of them.
    """

    name: str
    schema: str | Callable[[Logged], str]
    fields: Callable[[Logged], tuple[Field, ...]]
    filled_by: str
    since: str
    logged: Callable[[Logged], bool] = lambda logged: True
    values: Callable[[SlotRecord], Sequence[Any] | None] | None = None
    curves: Callable[[Sequence[str], Sequence[str]], Sequence[Curve]] = lambda fields, outputs: ()
    paged: bool = False
    frames: bool = False

    def schema_name(self, logged: Logged) -> str:
        """Return the name of its record in a session."""
        return f"hil/msg/{self.schema if isinstance(self.schema, str) else self.schema(logged)}"


class MissingTopic(HilError, KeyError):
    """A log has no records of a topic that a reader needs."""

    def __str__(self) -> str:
        return str(self.args[0])


def floats(signals: Sequence[Signal]) -> tuple[Field, ...]:
    """Return a float64 field for each signal, with its unit."""
    # A comma would end the unit in the schema's text, a line break the line.
    return tuple(
        Field(type="float64", name=field_name(s.name), unit=" ".join(s.unit.replace(",", " ").split()) or "1") for s in signals
    )


def f64(name: str, unit: str, doc: str) -> Field:
    """Return a field of type float64."""
    return Field(type="float64", name=name, unit=unit, doc=doc)


def i64(name: str, unit: str, doc: str) -> Field:
    """Return a field of type int64."""
    return Field(type="int64", name=name, unit=unit, doc=doc)


def i32(name: str, unit: str, doc: str) -> Field:
    """Return a field of type int32."""
    return Field(type="int32", name=name, unit=unit, doc=doc)


def u8(name: str, doc: str) -> Field:
    """Return a field of type uint8."""
    return Field(type="uint8", name=name, doc=doc)


SLOT: Final = i64("slot", "1", "slot k")
PACKET_SLOT: Final = i64("packet_slot", "1", "slot in which the packet was sent, -1 if none")
