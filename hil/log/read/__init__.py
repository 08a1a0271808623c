"""Reading a log: arrays, recovery of what is torn, export. Every record is checked, and nothing of a log is run.

Whether it holds what hil's own recorder writes is checked once, here: behind this no type is in doubt.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from mcap.opcode import Opcode
from mcap.records import Channel

from hil.errors import HilError, located
from hil.log import Logged, decode_events
from hil.log.read.mcap_file import Columns, Content, open_mcap, start_instant
from hil.log.read.mcap_walk import MESSAGE_PAYLOAD_AT, Budget, Checksums, DamagedRecord, Record, TornFile, walk
from hil.log.records import EVENTS_TOPIC, Schema
from hil.log.run import Arrays
from hil.log.run import Run as Run
from hil.log.topics import MEASUREMENT, REFERENCE, TOPICS
from hil.log.write.provenance import FORMAT


def check_topics(schemas: Mapping[str, Schema]) -> None:
    """Check that every topic that the registry knows has the fields that do not depend on the plant; a log may lack a topic.

    Args:
        schemas: topic to what the log says of it.

    Raises:
        HilError: names the topic and the field.
    """
    for topic in [name for name in TOPICS if name in schemas]:
        found = {f.name: f.type for f in schemas[topic].fields}
        for field in TOPICS[topic].fields(Logged()):
            if found.get(field.name) != field.type:
                raise HilError(f"topic {topic}: field {field.name}: is {found.get(field.name, 'missing')}, expected {field.type}")
    outputs, reference = (schemas[topic].floats if topic in schemas else None for topic in (MEASUREMENT.name, REFERENCE.name))
    if None not in (outputs, reference) and outputs != reference:
        raise HilError(f"topic {REFERENCE.name}: signals {', '.join(reference or ())}, expected those that are measured")


SLOTS_PER_RECORD: Final = 16
"""Slots of a log for each of its records: a session writes several of each slot, and `hil recover` may save a part of them."""


LATEST_US: Final = 1e15


def check_extremes(extremes: Mapping[str, Mapping[str, tuple[float, float]]], records: int) -> None:
    """Check that a log is of as many slots as its records can be, for who reads it takes memory and work for each; and its times.

    Args:
        extremes: of each topic, see `Columns`.
        records: of all topics.

    Raises:
        HilError: names the topic and the field.
    """
    for topic, found in extremes.items():
        for name, (least, largest) in found.items():
            low, high = (-1, SLOTS_PER_RECORD * records) if name == "slot" else (-LATEST_US, LATEST_US)
            if not low <= least <= largest <= high:
                raise HilError(f"topic {topic}: {name}: {least} to {largest}; in a log of {records} records {low:g} to {high:g}")


def check_events(events: Sequence[Mapping[str, Any]]) -> None:
    """Check of every event what CDR cannot say: that its data are a table, and its instant is one.

    Args:
        events: as they stand in the log, see `hil.log.decode_event`.

    Raises:
        HilError: names the event and the field.
    """
    for index, event in enumerate(events):
        if not isinstance(event["data"], dict):
            raise HilError(f"event {index}: data: {event['data']!r:.60} is not of the type that events have")
        for name in ("slot", "t_s"):
            if not _number(event[name]):
                raise HilError(f"event {index}: {name}: {event[name]!r:.60} is no instant of a run")


def check_words(
    metadata: Mapping[str, str], resolved: Mapping[str, Any], summary: Mapping[str, Any], certificate: Mapping[str, Any]
) -> None:
    """Check what a log says about its session.

    Args:
        metadata: the record `hilrig`.
        resolved: the experiment after defaults, empty if the log carries none.
        summary: what closed the log.
        certificate: of the design, empty if there is none.

    Raises:
        HilError: names the field.
    """
    seed = metadata.get("seed", "")
    if not (seed.isascii() and seed.isdecimal() and len(seed) < 25):
        raise HilError(f"metadata hilrig: seed: {seed!r:.60}, expected a whole number")
    if resolved:
        period = resolved.get("period")
        if not isinstance(period, int | float) or isinstance(period, bool) or not 1e-6 < period < 1e6:
            raise HilError(f"resolved.json: period: {period!r:.60}, expected seconds")
        for name in ("network", "network.sc", "network.ca", "network.sc.law", "network.ca.law", "plant", "controller"):
            _table(resolved, name)
        pulses = resolved.get("disturbance", [])
        if not isinstance(pulses, list) or not all(isinstance(pulse, dict) and _number(pulse.get("at")) for pulse in pulses):
            raise HilError("resolved.json: disturbance: expected tables with an instant 'at'")
    for name in ("problems", "log"):
        if not isinstance(summary.get(name, {}), dict):
            raise HilError(f"metadata summary: {name}: {summary[name]!r:.60} is no table")
    for name, value in summary.get("log", {}).items():
        if not isinstance(value, int | str):
            raise HilError(f"metadata summary: log.{name}: {value!r:.60} is neither a count nor a name")
    for name in ("state", "reason") if certificate else ():
        if not isinstance(certificate.get(name), str):
            raise HilError(f"certificate.json: {name}: {certificate.get(name)!r:.60}, expected text")


def _table(resolved: Mapping[str, Any], path: str) -> None:
    node: Any = resolved
    for part in path.split("."):
        node = node.get(part, {})
        if not isinstance(node, dict):
            raise HilError(f"resolved.json: {path}: {node!r:.60} is no table")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e12 and math.isfinite(value)


def read_run(path: str | os.PathLike[str], *, whole: bool = True, descriptor: int | None = None) -> Run:
    """Read a log.

    Args:
        path: the file.
        whole: refuse a log that is torn or damaged. Otherwise read what is there: after a full disk, say.
        descriptor: the file, open already; its name may be gone. It stays open.

    Raises:
        HilError: if the file cannot be read, is no MCAP file, is no log of ours, is torn or damaged, or unpacks to far more
            than its length; the message names the file and the offset in it, and the remedy where there is one.
    """
    if not isinstance(path, str | os.PathLike):
        raise HilError(f"read_run: path: {path!r:.40}; expected the path of a log, text or a path")
    path = Path(path)
    with open_mcap(path, descriptor) as (file, size):
        reading, checksums, closed = _Reading(Content(budget=Budget(size)), path.parent), Checksums(), False
        try:
            for record in walk(file, size):
                try:
                    checksums.take(record)
                    reading.take(record)
                except DamagedRecord:
                    if whole:
                        raise
                closed = record.opcode == Opcode.FOOTER
            if not closed:
                raise TornFile(size, "the log was never closed")
        except (TornFile, DamagedRecord) as error:
            if whole:
                raise HilError(f"{path}: {error}; save its intact records with: hil recover {path}") from error
        except HilError as error:
            raise HilError(f"{path}: {error}") from error
    with located(path, HilError):
        return reading.run()


MOST_TOPICS: Final = 1000
"""Each takes some memory before its first record is a number; a session has twenty or so."""

EVENT_COST: Final = 8
"""Bytes of memory for each of an event, which becomes Python objects."""


class _Reading:
    """A run in the making: what the file holds, its messages as columns."""

    def __init__(self, content: Content, folder: Path) -> None:
        self.content = content
        self._folder = folder
        self._columns: dict[int, Columns] = {}
        self._events: list[dict[str, Any]] = []

    def take(self, record: Record) -> None:
        """Take one record of the file."""
        content = self.content
        content.take(record)
        if not content.messages:
            return
        for number in [*content.messages]:
            channel, messages = content.channels.get(number), content.messages.pop(number)
            if channel is None:
                raise DamagedRecord(f"messages at byte {record.offset}: no record before them says what channel {number} is")
            if channel.topic == EVENTS_TOPIC:
                payloads = [message[MESSAGE_PAYLOAD_AT:] for message in messages]
                content.budget.take(EVENT_COST * sum(map(len, payloads)), record)
                self._events += decode_events(payloads, len(self._events))
                continue
            self._columns_of(number, channel).add(messages)

    def _columns_of(self, number: int, channel: Channel) -> Columns:
        if number not in self._columns:
            if len(self._columns) == MOST_TOPICS:
                raise HilError(f"more than {MOST_TOPICS} topics; no session has as many")
            schema = _schema(self.content, channel)
            self._columns[number] = Columns(channel.topic, schema, self._folder, start_of(self.content))
        return self._columns[number]

    def run(self) -> Run:
        """Return what was read."""
        content, columns = self.content, dict[str, Columns]()
        head = content.metadata.get("hilrig")
        if head is None:
            raise HilError("is an MCAP file, but not a log of hilrig: it has no metadata record 'hilrig'")
        if head.get("format") != FORMAT:
            raise HilError(f"log format {head.get('format')!r} is unknown, this version reads {FORMAT}")
        for number, channel in content.channels.items():
            if channel.topic == EVENTS_TOPIC:
                continue
            if channel.topic in columns:
                raise HilError(f"topic {channel.topic}: occurs twice in the file")
            columns[channel.topic] = self._columns_of(number, channel)
            columns[channel.topic].finish()
        schemas = {topic: each.schema for topic, each in columns.items()}
        if not columns:
            raise HilError("holds no records: the session ended before the first of them was written")
        resolved, certificate = (_attached_json(content, name) for name in ("resolved.json", "certificate.json"))
        summary = _json_object(content.metadata.get("summary", {}).get("json", "{}"), "metadata 'summary'")
        if content.metadata.get("recovery", {}).get("closed") == "False" and isinstance(summary.setdefault("problems", {}), dict):
            summary["problems"]["recovered"] = "rebuilt from a torn log: its end is missing"
        check_topics(schemas)
        records = sum(each.records for each in columns.values())
        check_extremes({topic: each.extremes for topic, each in columns.items()}, records)
        check_events(self._events)
        check_words(head, resolved, summary, certificate)
        text = content.attachments.get("experiment.toml")
        return Run(
            arrays=Arrays(columns),
            schemas=schemas,
            events=self._events,
            metadata=head,
            versions=content.metadata.get("versions", {}),
            session=content.metadata.get("session", {}),
            codes={name: names.split(",") for name, names in content.metadata.get("codes", {}).items()},
            experiment_text=text.data.decode(errors="replace") if text is not None else "",
            resolved=resolved,
            certificate=certificate,
            summary=summary,
            start_ns=start_of(content),
        )


def start_of(content: Content) -> int:
    """Return the wall-clock instant of session time 0, ns since 1970; 0 where the file does not say.

    Raises:
        HilError: it says something else than an instant.
    """
    clock = {"start_ns": "0"} | content.metadata.get("clock", {})
    found = start_instant(clock)
    if found is None:
        raise HilError(f"metadata clock: start_ns: {clock['start_ns']!r:.60}, expected nanoseconds since 1970")
    return found


def _schema(content: Content, channel: Channel) -> Schema:
    found = content.schemas.get(channel.schema_id)
    if found is None or found.encoding != "ros2msg" or channel.message_encoding != "cdr":
        other = "" if "hilrig" in content.metadata else "is an MCAP file, but not a log of hilrig: "
        raise HilError(f"{other}topic {channel.topic}: expected a ros2msg schema and CDR messages")
    with located(f"topic {channel.topic}: unknown schema", ValueError):
        return Schema.from_text(found.name, found.data.decode())


def _attached_json(content: Content, name: str) -> dict[str, Any]:
    attachment = content.attachments.get(name)
    return _json_object(attachment.data, f"attachment {name}") if attachment is not None else {}


def _json_object(text: str | bytes, what: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise HilError(f"{what} is no JSON: {error!s:.200}") from error
    if not isinstance(value, dict):
        raise HilError(f"{what} is no JSON object")
    return value
