"""A log in the formats of other people's tools: CAN logs from its frames, tables from its signals.

========= ===================================================================================================
``.log``  candump's text format (``can-utils``, SavvyCAN, cantools), through python-can
``.blf``  Vector's binary format (CANalyzer, CANoe), through python-can
``.asc``  Vector's text format, through python-can; its times count from the first frame
``.trc``  PEAK's text format, through python-can: classic frames only
``.mf4``  ASAM MDF 4, through python-can and asammdf (the extra ``mf4``)
``.csv``  one table per topic, numbers in full precision, units in the header
``.npz``  one structured array per topic for ``numpy.load``; raw frames as a matrix of bytes, padded with zeros
========= ===================================================================================================

Frames of a CAN log stand at the instants that were measured, counted from the moment at which the session began; a run in
virtual time begins at 2000-01-01 UTC, since can-utils take a time below 1 s for "not begun yet". Tables have session times.
"""

from __future__ import annotations

import csv
import heapq
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from datetime import datetime
from functools import partial
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, Literal
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from numpy.lib import format as npy

from hil.errors import HilError, nearest
from hil.experiment import experiment_from_resolved
from hil.files import written_whole
from hil.log.append_column import pieces
from hil.log.read.measured_frames import measured_frames
from hil.log.read.run import Run
from hil.log.records import EVENTS_TOPIC, TIME_FIELD
from hil.log.run import StructuredArray
from hil.log.topics import FRAME_TOPICS, SENSOR
from hil.rig.normal_form import rig_of
from hil.rig.session_link import no_link

if TYPE_CHECKING:
    from transport.links.can_identifiers import Identifiers


def _add_array(
    archive: ZipFile, name: str, dtype: np.dtype[Any], shape: tuple[int, ...], parts: Iterable[np.ndarray[Any, Any]]
) -> None:
    """Add an array as `numpy.savez_compressed` would, its rows piece by piece: no array is ever whole in memory."""
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        _head(file, dtype, shape)
        for part in parts:
            file.write(np.ascontiguousarray(part, dtype).tobytes())


def _head(file: IO[bytes], dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    about = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    try:
        npy.write_array_header_1_0(file, about)
    except ValueError:  # longer than 64 KiB
        npy.write_array_header_2_0(file, about)


VIRTUAL_BEGIN: Final = "2000-01-01T00:00:00Z"
ROWS: Final = 4096  # that are made Python numbers at a time


def export(run: Run, target: str | os.PathLike[str], topics: Sequence[str] = (), *, replace: bool = False) -> list[Path]:
    """Write a run in the format that the target's ending names.

    Args:
        run: what to write.
        target: ``.log``, ``.blf``, ``.asc``, ``.trc``, ``.mf4``, ``.csv`` or ``.npz``. Tables of more than one topic make files
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
    writers = dict.fromkeys((".log", ".blf", ".asc", ".trc", ".mf4"), _can_log) | {".csv": _tables, ".npz": _npz}
    writer = writers.get(target.suffix)
    if writer is None:
        raise HilError(f"{target}: the ending {target.suffix!r} names no format, expected {', '.join(writers)}")
    known = (*run.arrays, EVENTS_TOPIC) if target.suffix == ".csv" else (*run.arrays,)
    for topic in topics:
        if topic not in known:
            raise HilError(f"topic {topic!r}: not in the log, expected one of {', '.join(known)}{nearest(topic, known)}")
    wanted = [*dict.fromkeys(topics or known)]
    paths = [target] if target.suffix != ".csv" or len(wanted) == 1 else [
        target.with_suffix(f".{_plain_name(topic)}.csv") for topic in wanted
    ]
    for path in paths:
        if not replace and os.path.lexists(path):  # now, and not after half of the files
            raise HilError(f"{path}: exists already; choose another -o, or add --force")
    writer(run, paths, wanted, replace)
    return paths


def _tables(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
    with ExitStack() as stack:  # none is put in its place before all are whole
        parts = [stack.enter_context(written_whole(path, replace=replace)) for path in paths]
        for topic, part in zip(topics, parts, strict=True):
            with open(part, "w", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows(_events(run) if topic == EVENTS_TOPIC else _records(run, topic))


def _records(run: Run, topic: str) -> Iterator[Sequence[Any]]:
    yield [f"{TIME_FIELD} [ns]", *(f"{f.name} [{f.unit}]" for f in run.schemas[topic].fields)]
    for piece in run.pieces(topic, ROWS):
        for row in piece.tolist():  # plain floats print so that they read back the same
            yield [value.hex() if isinstance(value, bytes) else value for value in row]


def _events(run: Run) -> Iterator[Sequence[Any]]:
    names = ["tick", "t_s", "kind", "severity", "message"]
    yield [*names, "data"]
    for event in run.events:
        yield [*(event.get(name, "") for name in names), json.dumps(event.get("data", {}))]


def _npz(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
    with written_whole(paths[0], replace=replace) as part, ZipFile(part, "w", ZIP_DEFLATED) as file:
        for topic in topics:
            name, numbers = _plain_name(topic), run.numbers(topic)
            fields = [field for field in numbers.dtype.names or () if not run.schemas[topic].raw or field != "data"]
            dtype = np.dtype([(field, numbers.dtype[field]) for field in fields])  # packed: a file cannot say a gap
            if run.schemas[topic].raw:
                lengths = np.concatenate([np.empty(0, np.uint32), *(_lengths(piece) for piece in run.pieces(topic, ROWS))])
                most = int(lengths.max(initial=0))
                padded = (_padded(piece, most) for piece in run.pieces(topic, ROWS))
                _add_array(file, f"{name}_data", np.dtype(np.uint8), (len(lengths), most), padded)
                _add_array(file, f"{name}_length", lengths.dtype, lengths.shape, [lengths])
            packed = (_of_fields(piece, dtype) for piece in pieces(numbers, ROWS))
            _add_array(file, name, dtype, numbers.shape, packed)


def _lengths(piece: StructuredArray) -> np.ndarray[Any, np.dtype[np.uint32]]:
    return np.array([len(item) for item in piece["data"]], np.uint32)


def _padded(piece: StructuredArray, most: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.frombuffer(b"".join(item.ljust(most, b"\0") for item in piece["data"]), np.uint8)


def _of_fields(piece: StructuredArray, dtype: np.dtype[Any]) -> StructuredArray:
    out = np.empty(len(piece), dtype)
    for name in dtype.names or ():
        out[name] = piece[name]
    return out


def _can_log(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
    from transport.links.python_can import can, with_mf4

    target = paths[0]

    wanted = [topic for topic in FRAME_TOPICS if topic in topics]
    if not any(len(run.numbers(topic)) for topic in wanted):
        raise HilError(f"{target}: no frames to write; a CAN log needs the records of {' and '.join(FRAME_TOPICS)}")
    if target.suffix == ".trc" and _framing(run)[0]:
        raise HilError(f"{target}: python-can writes classic frames only as .trc, and this link has CAN FD; export .asc instead")
    if target.suffix == ".mf4" and find_spec("asammdf") is None:
        raise HilError(f"{target}: .mf4 needs asammdf: pip install 'hilrig[mf4]'")
    make = with_mf4() if target.suffix == ".mf4" else can.Logger  # which picks the writer by the ending
    with written_whole(target, replace=replace) as part, make(part) as writer:
        for message in _can_messages(run, wanted):
            writer.on_message_received(message)


def _can_messages(run: Run, topics: Sequence[str]) -> Iterator[Any]:
    """The run's frames as they stood on a CAN bus, in the order of time.

    The framing is that of ``transport.links.can_link``, with the ``fd`` and ``base`` of the session's own link if that was CAN.
    """
    return heapq.merge(*(_of_topic(run, topic) for topic in topics), key=attrgetter("timestamp"))


def _of_topic(run: Run, topic: str) -> Iterator[Any]:
    from transport.links.can_link import CanLink

    uri = run.metadata.get("link", "")
    fd, identifiers = _framing(run)
    bus = _BusOfPaper(fd)
    begin_s = run.start_ns / 1e9 or datetime.fromisoformat(run.session.get("started", VIRTUAL_BEGIN)).timestamp()
    role: Literal["rig", "controller"] = "rig" if topic == SENSOR.name else "controller"
    link = CanLink(uri, role, lambda: bus, identifiers=identifiers, fd=fd)
    for t_ns, packet in measured_frames(run, topic):
        bus.t_s = begin_s + t_ns / 1e9
        link.send(packet)
        if link.counters.dropped:
            raise HilError(f"{topic} at {t_ns / 1e9:g} s: {len(packet)} bytes do not fit on CAN; export .csv instead")
        yield from bus.messages
        bus.messages.clear()


def _framing(run: Run) -> tuple[bool, Identifiers]:
    """Whether a run's frames are CAN FD, and its identifiers; the default ones of its nodes for what is no CAN link."""
    from transport.links import TransportError
    from transport.links.can_identifiers import derived
    from transport.links.traits import identifiers_on, traits_of

    uri = run.metadata.get("link", "")
    with suppress(TransportError, ValueError):  # no session could have run over it
        framing = traits_of(uri).can
        if framing is not None:
            return framing.fd, identifiers_on(uri)
    if not run.resolved.get("network", {}).get("nodes"):
        return True, derived()
    own = no_link(rig_of(experiment_from_resolved(run.resolved, run.experiment_text, "the log"))).identifiers
    if own is None:
        raise HilError("the log: a CAN link has no identifiers for so many nodes; export .csv instead")
    return True, own


class _BusOfPaper:
    """A bus as a link uses it, that keeps what is said on it as messages of python-can, with the time of the log."""

    lost = turned_away = filtered = 0

    def __init__(self, fd: bool) -> None:
        from transport.links.python_can import can

        self.messages: list[Any] = []
        self.t_s = 0.0
        self._message = partial(can.Message, is_extended_id=False, is_fd=fd, bitrate_switch=fd, channel=0)

    def send_frame(self, identifier: int, data: bytes) -> bool:
        self.messages.append(self._message(arbitration_id=identifier, data=data, timestamp=self.t_s))
        return True

    def recv_frame(self, timeout: float) -> None:
        """No other is on it."""

    def shutdown(self) -> None:
        """Nothing is open."""


def _plain_name(topic: str) -> str:
    return topic.strip("/").replace("/", "_")
