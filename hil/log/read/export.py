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
A run with an emulated CAN bus gives the frames of that bus, see `hil.log.read.can_log`.
"""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, Final
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from numpy.lib import format as npy

from hil.errors import HilError, located, nearest
from hil.files import written_whole
from hil.log.append_column import pieces
from hil.log.read import Run
from hil.log.read.can_log import beyond_classic, can_messages, can_topics
from hil.log.records import EVENTS_TOPIC, TIME_FIELD
from hil.log.run import StructuredArray


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


PARQUET: Final = "; pandas writes a topic as Parquet: pandas.DataFrame(hil.read_run(LOG).arrays[TOPIC]).to_parquet(FILE)"
ROWS: Final = 4096  # that are made Python numbers at a time


def export(run: Run, target: str | os.PathLike[str], topics: Sequence[str] = (), *, replace: bool = False) -> list[Path]:
    """Write a run in the format that the target's ending names.

    Args:
        run: what to write.
        target: ``.log``, ``.blf``, ``.asc``, ``.trc``, ``.mf4``, ``.csv``, ``.npz`` or ``.mat``. Tables of more than one topic
            make files ``name.topic.csv``.
        topics: only these; all by default. CAN logs hold ``/link/bus`` where there is one, else ``/link/sensor`` and
            ``/link/control``.
        replace: replace files that are there, each when it is whole. Otherwise none is touched where one is in the way.

    Returns:
        The files written.

    Raises:
        HilError: if the ending or a topic is unknown, a frame cannot be a CAN frame, a file exists already (without
            ``replace``) or cannot be written.
    """
    target = Path(target)
    writers = dict.fromkeys((".log", ".blf", ".asc", ".trc", ".mf4"), _can_log) | {".csv": _tables, ".npz": _npz, ".mat": _mat}
    writer = writers.get(target.suffix)
    if writer is None:
        said = PARQUET if target.suffix == ".parquet" else ""
        raise HilError(f"{target}: the ending {target.suffix!r} names no format, expected {', '.join(writers)}{said}")
    known = (*run.arrays, EVENTS_TOPIC) if target.suffix == ".csv" else (*run.arrays,)
    for topic in topics:
        if topic not in known:
            raise HilError(f"topic {topic!r}: not in the log, expected one of {', '.join(known)}{nearest(topic, known)}")
    wanted = [*dict.fromkeys(topics or known)]
    named = {_plain_name(topic): topic for topic in wanted}
    for topic in wanted:
        if (other := named[_plain_name(topic)]) != topic:
            raise HilError(f"topics {topic!r} and {other!r} have one name in an export, {_plain_name(topic)!r}; name one")
    paths = (
        [target]
        if target.suffix != ".csv" or len(wanted) == 1
        else [target.with_suffix(f".{_plain_name(topic)}.csv") for topic in wanted]
    )
    for path in paths:
        if not replace and os.path.lexists(path):  # now, and not after half of the files
            raise HilError(f"{path}: exists already; choose another -o, or add --force")
    writer(run, paths, topics if writer is _can_log else wanted, replace)
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
    names = ["slot", "t_s", "kind", "severity", "message"]
    yield [*names, "data"]
    for event in run.events:
        yield [*(_cell(event.get(name, "")) for name in names), json.dumps(event.get("data", {}))]


def _cell(value: Any) -> Any:
    """Return a number as it is; a text in one line, behind an apostrophe where a spreadsheet would take it for a formula."""
    if not isinstance(value, str):
        return value
    text = value.replace("\r", r"\r")
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t")) else text


def _npz(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
    with written_whole(paths[0], replace=replace) as part, ZipFile(part, "w", ZIP_DEFLATED) as file:
        for topic in topics:
            name, numbers = _plain_name(topic), run.numbers(topic)
            fields = [field for field in numbers.dtype.names or () if not run.schemas[topic].raw or field != "data"]
            dtype = np.dtype([(field, numbers.dtype[field]) for field in fields])  # packed: a file cannot say a gap
            if run.schemas[topic].raw:
                lengths = _lengths(run, topic)
                most = int(lengths.max(initial=0))
                padded = (_padded(piece, most) for piece in run.pieces(topic, ROWS))
                _add_array(file, f"{name}_data", np.dtype(np.uint8), (len(lengths), most), padded)
                _add_array(file, f"{name}_length", lengths.dtype, lengths.shape, [lengths])
            packed = (piece[fields].astype(dtype) for piece in pieces(numbers, ROWS))
            _add_array(file, name, dtype, numbers.shape, packed)


def _mat(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
    from scipy.io import savemat  # MATLAB, and Octave

    structs = {}
    for topic in topics:
        numbers, raw = run.numbers(topic), run.schemas[topic].raw
        names = [name for name in numbers.dtype.names or () if not raw or name != "data"]
        structs[_plain_name(topic)] = {re.sub(r"\W", "_", name, flags=re.ASCII): numbers[name] for name in names}
        if raw:
            lengths = _lengths(run, topic)
            most = int(lengths.max(initial=0))
            data = np.concatenate([np.empty(0, np.uint8), *(_padded(piece, most) for piece in run.pieces(topic, ROWS))])
            structs[_plain_name(topic)] |= {"data": data.reshape(len(lengths), most), "length": lengths}
    with written_whole(paths[0], replace=replace) as part:
        savemat(part, structs, appendmat=False, long_field_names=True, do_compression=True, oned_as="column")


def _lengths(run: Run, topic: str) -> np.ndarray[Any, np.dtype[np.uint32]]:
    found = [np.array([len(item) for item in piece["data"]], np.uint32) for piece in run.pieces(topic, ROWS)]
    return np.concatenate([np.empty(0, np.uint32), *found])


def _padded(piece: StructuredArray, most: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.frombuffer(b"".join(item.ljust(most, b"\0") for item in piece["data"]), np.uint8)


def _can_log(run: Run, paths: Sequence[Path], topics: Sequence[str], replace: bool) -> None:
    from transport.links.python_can import can, with_mf4

    target = paths[0]
    with located(target, HilError):
        wanted = can_topics(run, topics)
    if target.suffix == ".trc" and (has := beyond_classic(run, wanted)):
        raise HilError(f"{target}: python-can writes classic frames only as .trc, and this log has {has}; export .asc instead")
    if target.suffix == ".mf4" and find_spec("asammdf") is None:
        raise HilError(f"{target}: .mf4 needs asammdf: pip install 'hilrig[mf4]'")
    make = with_mf4() if target.suffix == ".mf4" else can.Logger  # which picks the writer by the ending
    with written_whole(target, replace=replace) as part, make(part) as writer:
        for message in can_messages(run, wanted):
            writer.on_message_received(message)


def _plain_name(topic: str) -> str:
    return topic.strip("/").replace("/", "_")
