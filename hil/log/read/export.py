"""A log in the formats of other people's tools: CAN logs from its frames, tables from its signals.

========= ===================================================================================================
``.log``  candump's text format (``can-utils``, SavvyCAN, cantools), through python-can
``.blf``  Vector's binary format (CANalyzer, CANoe), through python-can
``.csv``  one table per topic, numbers in full precision, units in the header
``.npz``  one structured array per topic for ``numpy.load``; raw frames as a matrix of bytes, padded with zeros
========= ===================================================================================================

Frames of a CAN log stand at the instants that were measured, counted from the moment at which the session began; a run in
virtual time begins at 2000-01-01 UTC, since can-utils take a time below 1 s for "not begun yet". Tables have session times.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from hil.errors import HilError
from hil.log.read.arrays import StructuredArray
from hil.log.read.run import Run
from hil.log.records import EVENTS_TOPIC, TIME_FIELD, Schema

FRAME_TOPICS: Final = ("/link/sensor", "/link/control")
VIRTUAL_BEGIN: Final = "2000-01-01T00:00:00Z"


def export(run: Run, target: str | os.PathLike[str], topics: Sequence[str] = ()) -> list[Path]:
    """Write a run in the format that the target's ending names; existing files are replaced when all went well.

    Args:
        run: what to write.
        target: ``.log``, ``.blf``, ``.csv`` or ``.npz``. Tables of more than one topic make files ``name.topic.csv``.
        topics: only these; all by default. CAN logs hold ``/link/sensor`` and ``/link/control``.

    Returns:
        The files written.

    Raises:
        HilError: if the ending or a topic is unknown, a frame cannot be a CAN frame, or a file cannot be written.
    """
    target = Path(target)
    writers = {".log": _can_log, ".blf": _can_log, ".csv": _tables, ".npz": _npz}
    writer = writers.get(target.suffix)
    if writer is None:
        raise HilError(f"{target}: the ending {target.suffix!r} names no format, expected {', '.join(writers)}")
    known = (*run.arrays, EVENTS_TOPIC) if target.suffix == ".csv" else (*run.arrays,)
    for topic in topics:
        if topic not in known:
            raise HilError(f"topic {topic!r}: not in the log, expected one of {', '.join(known)}")
    return writer(run, target, topics or known)


def _replace(target: Path, write: Callable[[Path], None]) -> Path:
    """Write beside the target and move it there at the end: a failure leaves what was there."""
    part = target.with_name(f".{target.stem}.part{target.suffix}")
    try:
        write(part)
        part.replace(target)
    except OSError as error:
        raise HilError(f"{target}: cannot be written: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)
    return target


def _tables(run: Run, target: Path, topics: Sequence[str]) -> list[Path]:
    if len(topics) == 1:
        paths = [target]
    else:
        paths = [target.with_suffix(f".{_plain_name(topic)}.csv") for topic in topics]
    for topic, path in zip(topics, paths, strict=True):
        if topic == EVENTS_TOPIC:
            _replace(path, lambda part: _write_events(run, part))
        else:
            array, schema = run.arrays[topic], run.schemas[topic]
            _replace(path, lambda part, array=array, schema=schema: _write_csv(array, schema, part))  # type: ignore[misc]
    return paths


def _write_csv(array: StructuredArray, schema: Schema, path: Path) -> None:
    header = [f"{TIME_FIELD} [ns]", *(f"{f.name} [{f.unit}]" for f in schema.fields)]
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for row in array.tolist():  # plain floats print so that they read back the same
            writer.writerow([value.hex() if isinstance(value, bytes) else value for value in row])


def _write_events(run: Run, path: Path) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = ["tick", "t_s", "kind", "severity", "message"]
        writer.writerow([*names, "data"])
        for event in run.events:
            writer.writerow([*(event.get(name, "") for name in names), json.dumps(event.get("data", {}))])


def _npz(run: Run, target: Path, topics: Sequence[str]) -> list[Path]:
    arrays: dict[str, np.ndarray[Any, np.dtype[Any]]] = {}
    for topic in topics:
        array, name = run.arrays[topic], _plain_name(topic)
        if run.schemas[topic].raw:
            data = array["data"]
            lengths = np.array([len(item) for item in data], np.uint32)
            matrix = np.zeros((len(data), int(lengths.max(initial=0))), np.uint8)
            for row, item in zip(matrix, data, strict=True):
                row[: len(item)] = np.frombuffer(item, np.uint8)
            arrays[f"{name}_data"], arrays[f"{name}_length"] = matrix, lengths
            array = array[[field for field in array.dtype.names or () if field != "data"]].copy()
        arrays[name] = array

    def write(part: Path) -> None:
        with open(part, "wb") as file:  # a name would get a second ending
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]

    return [_replace(target, write)]


def _can_log(run: Run, target: Path, topics: Sequence[str]) -> list[Path]:
    import can

    messages = _can_messages(run, [topic for topic in FRAME_TOPICS if topic in topics])
    if not messages:
        raise HilError(f"{target}: no frames to write; a CAN log is made of the records of {' and '.join(FRAME_TOPICS)}")

    def write(part: Path) -> None:
        with can.Logger(part) as writer:  # python-can picks the writer by the ending
            for message in messages:
                writer.on_message_received(message)

    return [_replace(target, write)]


def _can_messages(run: Run, topics: Sequence[str]) -> list[Any]:
    """The run's frames as they stood on a CAN bus, in the order of time.

    The framing is that of ``transport.links.can_link``, with the ``fd`` and ``base`` of the session's own link if that was CAN.
    """
    from transport.links.can_link import CanLink

    uri = run.metadata.get("link", "")
    fd, base = _framing(uri)
    bus: Any = _BusOfPaper()
    begin_s = datetime.fromisoformat(run.session.get("started", VIRTUAL_BEGIN)).timestamp()
    for topic in topics:
        role: Literal["rig", "controller"] = "rig" if topic == "/link/sensor" else "controller"
        link = CanLink(uri, role, lambda: bus, base=base, fd=fd)
        for t_ns, packet in zip(measured_ns(run, topic), run.arrays[topic]["data"], strict=True):
            bus.t_s = begin_s + t_ns / 1e9
            link.send(packet)
            if link.counters.dropped:
                raise HilError(f"{topic} at {t_ns / 1e9:g} s: {len(packet)} bytes do not fit on CAN; export .csv instead")
    return sorted(bus.messages, key=lambda message: message.timestamp)


def measured_ns(run: Run, topic: str) -> list[int]:
    """Return the instant of every frame of a topic in session time, ns: nominal plus what was measured of that slot."""
    frames, timing = run.arrays[topic], run.arrays["/timing/tick"]
    late_us = timing["lateness_us"] + (np.nan_to_num(timing["round_trip_us"]) if topic == "/link/control" else 0.0)
    measured = dict(zip(timing["tick"].tolist(), np.round(late_us * 1e3).astype(np.int64).tolist()))
    return [t_ns + measured.get(tick, 0) for t_ns, tick in zip(frames[TIME_FIELD].tolist(), frames["tick"].tolist())]


def _framing(uri: str) -> tuple[bool, int]:
    """Whether a link's frames are CAN FD, and its first identifier; the defaults for what is no CAN link."""
    from transport.links.can_link import BASE
    from transport.links.link import TransportError, split_uri

    try:
        scheme, _, options = split_uri(uri)
        if scheme == "can":
            return options.get("fd", "1") == "1", int(options.get("base", str(BASE)), 0)
    except (TransportError, ValueError):
        pass  # no session could have run over it
    return True, BASE


class _BusOfPaper:
    """As much of a python-can bus as a link needs to say its frames, which are kept with the time of the log."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self.t_s = 0.0

    def send(self, message: Any, timeout: float | None = None) -> None:
        message.timestamp = self.t_s
        message.channel = 0
        self.messages.append(message)

    def shutdown(self) -> None:
        """Nothing is open."""


def _plain_name(topic: str) -> str:
    return topic.strip("/").replace("/", "_")
