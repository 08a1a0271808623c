"""The registry of the log's topics: every module of this folder gives its `TOPICS`. A new topic is one file here.

Writer, reader, live view, layouts, export, measures and pages ask here for names, schemas and plots. A reader asks a run for the
topics that it needs (`hil.log.run.Run.needs`): a log from before a topic was there is read as ever.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import chain
from pkgutil import iter_modules
from re import findall
from typing import TYPE_CHECKING, Final

from hil.errors import HilError, nearest
from hil.log.records import Channel, Schema
from hil.log.topics import loop
from hil.log.topics.loop import APPLIED, BUS, CA, CONTROL, MEASUREMENT, PASSIVITY, REFERENCE, ROWS, SC, SENSOR, STATE, TIMING
from hil.log.topics.topic import Curve, Logged, MissingTopic, Topic

if TYPE_CHECKING:
    from hil.rig.loop import Loop

__all__ = [
    "APPLIED", "BUS", "CA", "CONTROL", "FRAME_TOPICS", "MEASUREMENT", "NUMBER_TOPICS", "PASSIVITY", "REFERENCE", "ROWS", "SC",
    "SENSOR", "STATE", "TIMING", "TOPICS", "Curve", "Logged", "MissingTopic", "Topic", "channels", "channels_of", "in_log_of",
    "missing", "panels",
]  # fmt: skip


def _registered() -> dict[str, Topic]:
    names = [module.name for module in iter_modules(__path__, f"{__name__}.")]
    others = [import_module(name).TOPICS for name in names if name not in (f"{__name__}.loop", f"{__name__}.topic")]
    return {topic.name: topic for topic in chain(loop.TOPICS, *others)}


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
        try:
            schema = Schema(name=topic.schema_name(logged), fields=topic.fields(logged))
        except ValueError as error:
            raise HilError(f"log topic {topic.name}: {error}; signals need names that differ") from None
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
