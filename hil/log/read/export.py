"""A log in the formats of other people's tools: CAN logs from its frames, tables from its signals.

========= ===================================================================================================
``.log``  candump's text format (``can-utils``, SavvyCAN, cantools), through python-can
``.blf``  Vector's binary format (CANalyzer, CANoe), through python-can
``.asc``  Vector's text format, through python-can; its times count from the first frame
``.trc``  PEAK's text format, through python-can: classic frames only
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
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.lib.recfunctions import repack_fields

from hil.errors import HilError
from hil.exclusive_file import written_whole
from hil.log.read.arrays import StructuredArray
from hil.log.read.run import Run
from hil.log.records import EVENTS_TOPIC, TIME_FIELD, Schema

FRAME_TOPICS: Final = ("/link/sensor", "/link/control")
VIRTUAL_BEGIN: Final = "2000-01-01T00:00:00Z"
ROWS: Final = 4096  # that are made Python numbers at a time


def export(run: Run, target: str | os.PathLike[str], topics: Sequence[str] = (), *, replace: bool = False) -> list[Path]:
    """Write a run in the format that the target's ending names.

    Args:
        run: what to write.
        target: ``.log``, ``.blf``, ``.asc``, ``.trc``, ``.csv`` or ``.npz``. Tables of more than one topic make files
            ``name.topic.csv``.
        topics: only these; all by default. CAN logs hold ``/link/sensor`` and ``/link/control``.
        replace: replace files that are there, each when it is whole. Otherwise none is touched where one is in the way.

    Returns:
        The files written.

    Raises:
        HilError: if the ending or a topic is unknown, a frame cannot be a CAN frame, a file exists already (without
            ``replace``) or cannot be written.
    """
    target = Path(target)
    writers = {".log": _can_log, ".blf": _can_log, ".asc": _can_log, ".trc": _can_log, ".csv": _tables, ".npz": _npz}
    writer = writers.get(target.suffix)
    if writer is None:
        raise HilError(f"{target}: the ending {target.suffix!r} names no format, expected {', '.join(writers)}")
    known = (*run.arrays, EVENTS_TOPIC) if target.suffix == ".csv" else (*run.arrays,)
    for topic in topics:
        if topic not in known:
            raise HilError(f"topic {topic!r}: not in the log, expected one of {', '.join(known)}")
    wanted = [*dict.fromkeys(topics or known)]
    paths = [target] if target.suffix != ".csv" or len(wanted) == 1 else [_table_path(target, topic) for topic in wanted]
    for path in paths:
        if not replace and os.path.lexists(path):  # now, and not after half of the files
            raise HilError(f"{path}: exists already; choose another -o, or add --force")
    writer(run, paths, wanted, replace)
    return paths


def _table_path(target: Path, topic: str) -> Path:
    return target.with_suffix(f".{_plain_name(topic)}.csv")


def _tables(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
    for topic, path in zip(topics, paths, strict=True):
        with written_whole(path, replace=replace) as part:
            if topic == EVENTS_TOPIC:
                _write_events(run, part)
            else:
                _write_csv(run.arrays[topic], run.schemas[topic], part)


def _write_csv(array: StructuredArray, schema: Schema, path: Path) -> None:
    header = [f"{TIME_FIELD} [ns]", *(f"{f.name} [{f.unit}]" for f in schema.fields)]
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for start in range(0, len(array), ROWS):
            for row in array[start : start + ROWS].tolist():  # plain floats print so that they read back the same
                writer.writerow([value.hex() if isinstance(value, bytes) else value for value in row])


def _write_events(run: Run, path: Path) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = ["tick", "t_s", "kind", "severity", "message"]
        writer.writerow([*names, "data"])
        for event in run.events:
            writer.writerow([*(event.get(name, "") for name in names), json.dumps(event.get("data", {}))])


def _npz(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
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
            # Packed again: a selection keeps the gap of the field that it leaves out, which a file cannot say.
            array = repack_fields(array[[field for field in array.dtype.names or () if field != "data"]])
        arrays[name] = array

    with written_whole(paths[0], replace=replace) as part, open(part, "wb") as file:  # a name would get a second ending
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def _can_log(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
    import can

    target = paths[0]

    messages = _can_messages(run, [topic for topic in FRAME_TOPICS if topic in topics])
    if not messages:
        raise HilError(f"{target}: no frames to write; a CAN log is made of the records of {' and '.join(FRAME_TOPICS)}")

    if target.suffix == ".trc" and any(message.is_fd for message in messages):
        raise HilError(f"{target}: python-can writes classic frames only as .trc, and this link has CAN FD; export .asc instead")
    with written_whole(target, replace=replace) as part, can.Logger(part) as writer:  # picks the writer by the ending
        for message in messages:
            writer.on_message_received(message)


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
