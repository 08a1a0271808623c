"""Logs in MCAP: topics and events, what is written while a run goes on, what is read afterwards.

A topic is one object that writer, reader, live view, layouts, export, measures and pages read. An event is written when something
went wrong, so writing it must not go wrong: it is strict JSON, numbers that are not finite become text, numpy becomes plain,
anything else becomes its ``str``.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from msgspec import Struct

from hil.errors import HilError
from hil.log.records import CDR_HEADER, Field, field_name
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


CHANGE: Final = "change"
"""Kind of the event that logs a change of a run; its data make the change again."""
WITHDRAWN: Final = "certificate withdrawn"
"""Kind of the event that says that a plant or a controller was not, in the run, what its certificate rests on."""
DEPARTED: Final = "part departed"
"""The same where no certificate rests on it."""

PLANT_FAILED: Final = "plant failed"
"""Kind of the event that says that a plant could not go on."""
PLUG_IN_FAILED: Final = "plug in failed"
"""The same of a part of the user's own that raised what no plant raises, with file and line."""
REFUSED: Final = "control refused"
"""Kind of the event that says why the rig refused the first control packet that it did not apply."""

_NUMBERS: Final = struct.Struct("<dq")
_LENGTH: Final = struct.Struct("<I")
_MAX_TEXT = 2000
_MAX_DEPTH = 20


def plain(value: object, depth: int = 0) -> Any:
    """Value made of dict, list, str, int, finite float, bool and None only.

    Args:
        value: mappings, sequences, sets, numpy arrays and scalars are taken apart.
        depth: level of nesting so far; beyond 20 the rest becomes text.

    >>> plain({"u": (1, float("nan")), "K": np.eye(1)})
    {'u': [1, 'nan'], 'K': [[1.0]]}
    """
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return int(value) if value.bit_length() <= 64 else hex(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(float(value))
    if depth > _MAX_DEPTH:
        return _text(value)
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist(), depth + 1)
    if isinstance(value, Mapping):
        return {_text(key): plain(item, depth + 1) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, depth + 1) for item in value]
    if isinstance(value, set | frozenset):
        return sorted((plain(item, depth + 1) for item in value), key=str)
    return _text(value)


def _text(value: object) -> str:
    try:
        return str(value)[:_MAX_TEXT]
    except Exception:  # a foreign __str__; an event must not fail for it
        return f"<{type(value).__name__}>"


def to_json(value: object, *, indent: int | None = None) -> bytes:
    """Strict JSON of ``plain(value)`` with sorted keys: equal values give equal bytes in every process."""
    separators = (",", ":") if indent is None else (",", ": ")
    text = json.dumps(plain(value), sort_keys=True, allow_nan=False, indent=indent, separators=separators)
    return text.encode("utf-8", "backslashreplace")


def encode_event(
    t_ns: int, kind: str, message: str, *, slot: int = -1, severity: str = "info", data: Mapping[str, object]
) -> bytes:
    """Payload of one ``/events`` record, CDR; see ``records.EVENT_SCHEMA``.

    Args:
        t_ns: nominal session time in ns.
        kind, message: a short name to filter by, and one sentence for people.
        slot: slot in which it happened, -1 outside of slots.
        severity: one of ``records.SEVERITIES``; others are kept as they are, an event is never lost for its form.
        data: values that belong to it.

    >>> decode_event(encode_event(1_000_000_000, "stop", "done", data={"u": math.nan}))
    {'t_s': 1.0, 'slot': -1, 'kind': 'stop', 'severity': 'info', 'message': 'done', 'data': {'u': 'nan'}}
    """
    parts = [CDR_HEADER, _NUMBERS.pack(t_ns / 1e9, slot)]
    for text in (kind, severity, message):
        parts.append(_string(text.replace("\0", "\\0").encode("utf-8", "backslashreplace")))
    return b"".join((*parts, _string(to_json(data)))).rstrip(b"\0") + b"\0"  # nothing stands behind the last text


def decode_event(payload: bytes) -> dict[str, Any]:
    """Return an event as ``encode_event`` was given it.

    Args:
        payload: CDR.

    Raises:
        HilError: it is none.
    """
    try:
        if payload[: len(CDR_HEADER)] != CDR_HEADER:
            raise ValueError("no little-endian CDR")
        t_s, slot = _NUMBERS.unpack_from(payload, len(CDR_HEADER))
        at, texts = len(CDR_HEADER) + _NUMBERS.size, []
        for _ in range(4):
            (size,) = _LENGTH.unpack_from(payload, at)
            text = payload[at + 4 : at + 4 + size]
            if len(text) < size or not text.endswith(b"\0"):
                raise ValueError("a text is cut off")
            texts.append(text[:-1].decode())
            at += 4 + size + -size % 4
        kind, severity, message, data = texts
        found = json.loads(data)
    except (ValueError, RecursionError, struct.error) as error:
        raise HilError(f"is no event: {error!s:.200}") from error
    return {"t_s": t_s, "slot": slot, "kind": kind, "severity": severity, "message": message, "data": found}


def _string(text: bytes) -> bytes:
    """A string in CDR: its length with the zero that ends it, the bytes, and zeros up to a multiple of 4."""
    size = len(text) + 1
    return _LENGTH.pack(size) + text + bytes(1 + -size % 4)


def decode_events(payloads: Sequence[bytes], first: int = 0) -> list[dict[str, Any]]:
    """Return the events of some payloads of ``/events``.

    Args:
        payloads: in the order of the log.
        first: number of the first of them, for what is said of one that cannot be read.

    Raises:
        HilError: with the number of the event.
    """
    found = []
    for index, payload in enumerate(payloads, first):
        try:
            found.append(decode_event(payload))
        except HilError as error:
            raise HilError(f"event {index}: {error}") from error
    return found
