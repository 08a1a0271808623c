"""Whether a log holds what hil's own recorder writes, checked once where it is read: nobody behind this need doubt a type."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hil.errors import HilError
from hil.log.records import Schema
from hil.log.topics import MEASUREMENT, REFERENCE, TOPICS, Logged

_EVENT = {"tick": int, "t_s": (int, float), "kind": str, "severity": str, "message": str, "data": dict}
_SIGNALS = (MEASUREMENT.name, REFERENCE.name)


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
    outputs, reference = (
        [f.name for f in schemas[topic].fields if f.type == "float64"] if topic in schemas else None for topic in _SIGNALS
    )
    if None not in (outputs, reference) and outputs != reference:
        raise HilError(f"topic {REFERENCE.name}: signals {', '.join(reference or ())}, expected those that are measured")


def check_events(events: Sequence[Mapping[str, Any]]) -> None:
    """Check that every event has its six fields, each of its type, and that its instant is one.

    Args:
        events: as they stand in the log.

    Raises:
        HilError: names the event and the field.
    """
    for index, event in enumerate(events):
        for name, kind in _EVENT.items():
            if not isinstance(event.get(name), kind) or isinstance(event.get(name), bool):  # type: ignore[arg-type]
                raise HilError(f"event {index}: {name}: {event.get(name)!r:.60} is not of the type that events have")
        for name in ("tick", "t_s"):
            if not _number(event[name]):
                raise HilError(f"event {index}: {name}: {event[name]!r:.60} is no instant of a run")


def check_words(metadata: Mapping[str, str], resolved: Mapping[str, Any], summary: Mapping[str, Any]) -> None:
    """Check what a log says about its session.

    Args:
        metadata: the record `hilrig`.
        resolved: the experiment after defaults, empty if the log carries none.
        summary: what closed the log.

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


def _table(resolved: Mapping[str, Any], path: str) -> None:
    node: Any = resolved
    for part in path.split("."):
        node = node.get(part, {})
        if not isinstance(node, dict):
            raise HilError(f"resolved.json: {path}: {node!r:.60} is no table")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e12 and math.isfinite(value)
