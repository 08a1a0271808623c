"""A finished run in memory: one numpy array per topic, the events, and where it all came from.

The bytes of many records become one structured array without being touched one by one. What reads a run from a file is
`hil.log.read`: a run in virtual time keeps its columns, and needs none of it.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from typing import Any, Final, Protocol, cast

import numpy as np
from msgspec import Struct, field
from msgspec.structs import force_setattr

from hil.errors import HilError, unknown_name
from hil.log import decode_events
from hil.log.append_column import ROWS, pieces
from hil.log.records import CDR_HEADER, EVENTS_TOPIC, TIME_FIELD, Schema
from hil.log.topics import missing
from hil.log.write import MemorySink

StructuredArray = np.ndarray[Any, np.dtype[np.void]]
_CDR: Final = int.from_bytes(CDR_HEADER, "little")
_LENGTH: Final = struct.Struct("<I")


class Records(np.ndarray[Any, np.dtype[np.void]]):
    """Records of a topic; a field of them is a plain array."""

    def __getitem__(self, key: Any) -> Any:
        """Return a field by its name, else what numpy returns.

        Raises:
            UnknownName: no field is called so.
        """
        if not isinstance(key, str):
            return super().__getitem__(key)
        if key not in (self.dtype.names or ()):
            raise unknown_name("field of this topic", key, self.dtype.names or ())
        return self.view(np.ndarray)[key]


def run_dtype(schema: Schema) -> np.dtype[np.void]:
    """Fields of a run's array: ``t_ns``, the schema's numbers, and ``data`` (bytes objects) where frames are raw."""
    fields: list[tuple[str, Any]] = [(TIME_FIELD, "<i8")]
    fields += [(name, schema.dtype.fields[name][0]) for name in schema.dtype.names or () if schema.dtype.fields]
    if schema.raw:
        fields.append((schema.fields[-1].name, object))
    return np.dtype(fields)


def assemble(
    schema: Schema, records: Sequence[bytes], *, payload_at: int = 0, time_at: int | None = None,
    times: Sequence[int] = (),
) -> StructuredArray:
    """One array of equal records.

    Args:
        schema: layout of the payloads.
        records: each holds one payload at its end.
        payload_at: where the payload begins in a record.
        time_at: where the time (i64, little endian) stands in a record; else ``times`` are taken.
        times: nominal session times in ns.

    Returns:
        shape (len(records),). See ``run_dtype``.

    Raises:
        HilError: if a record is of another length than its schema says, or is no little-endian CDR.
    """
    out = np.empty(len(records), run_dtype(schema))
    if not len(records):
        return out
    if schema.raw:
        records, data = _split_raw(schema, records, payload_at)
        out[schema.fields[-1].name] = data
    table = _table(schema, records, payload_at, time_at)
    out[TIME_FIELD] = table[TIME_FIELD] if time_at is not None else np.asarray(times, np.int64)
    for name in schema.dtype.names or ():
        out[name] = table[name]
    return out


def _split_raw(
    schema: Schema, records: Sequence[bytes], payload_at: int
) -> tuple[list[bytes], np.ndarray[Any, np.dtype[np.object_]]]:
    """Records without their ``uint8[]``, and the bytes of it."""
    start, stop = payload_at + schema.data_offset, payload_at + 4 + schema.dtype.itemsize
    for index, record in enumerate(records):
        if len(record) < start or len(record) - start != _LENGTH.unpack_from(record, start - 4)[0]:
            raise HilError(f"record {index} of {schema.name}: {len(record) - payload_at} bytes, not as its length states")
    data = np.empty(len(records), object)
    data[:] = [record[start:] for record in records]
    return [record[:stop] for record in records], data


def _table(schema: Schema, records: Sequence[bytes], payload_at: int, time_at: int | None) -> StructuredArray:
    """The records' fixed part as numpy sees it: one dtype with holes over all of their bytes."""
    size = payload_at + 4 + schema.dtype.itemsize
    for index, record in enumerate(records):
        if len(record) != size:
            raise HilError(f"record {index} of {schema.name}: {len(record) - payload_at} bytes, expected {size - payload_at}")
    columns = [("_cdr", "<u4", payload_at)]  # a name that no field can have
    if time_at is not None:
        columns.append((TIME_FIELD, "<i8", time_at))
    for name, (kind, offset, *_) in (schema.dtype.fields or {}).items():
        columns.append((name, kind.str, payload_at + 4 + offset))
    names, formats, offsets = zip(*columns)
    layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    table: StructuredArray = np.frombuffer(b"".join(records), layout)
    if (table["_cdr"] != _CDR).any():
        raise HilError(f"record {int(np.argmax(table['_cdr'] != _CDR))} of {schema.name}: no little-endian CDR")
    return table


class InPieces(Protocol):
    """Records of a topic that need not be whole in memory; `numbers` may lack what is raw."""

    def array(self) -> StructuredArray: ...

    def pieces(self, rows: int) -> Iterator[StructuredArray]: ...

    def numbers(self) -> StructuredArray: ...


class Arrays(MutableMapping[str, StructuredArray]):
    """Topic to its records as one array, read only, made when it is first asked for; one that is not there is named.

    Args:
        held: of every topic, an array or what makes it.

    >>> Arrays({"/plant/state": np.zeros(3), "/reference": np.zeros(3)})
    Arrays(/plant/state, /reference)
    """

    def __init__(self, arrays: Mapping[str, StructuredArray | InPieces]) -> None:
        self._held = {topic: _fixed(each) if isinstance(each, np.ndarray) else each for topic, each in arrays.items()}

    def __getitem__(self, topic: str) -> StructuredArray:
        if topic not in self._held:
            raise missing(topic, [*self])
        held = self._held[topic]
        if not isinstance(held, np.ndarray):
            held = self._held[topic] = _fixed(held.array())
        return held

    def __setitem__(self, topic: str, array: StructuredArray) -> None:
        self._held[topic] = array

    def __delitem__(self, topic: str) -> None:
        del self._held[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self._held)

    def __contains__(self, topic: object) -> bool:
        return topic in self._held

    def __len__(self) -> int:
        return len(self._held)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self)})"

    def pieces(self, topic: str, rows: int) -> Iterator[StructuredArray]:
        """Give the records of a topic piece by piece."""
        held = self._held[topic]
        return pieces(held, rows) if isinstance(held, np.ndarray) else held.pieces(rows)

    def numbers(self, topic: str) -> StructuredArray:
        """Return the records of a topic, perhaps without what is raw."""
        held = self._held[topic]
        return held if isinstance(held, np.ndarray) else held.numbers()


def _fixed(array: StructuredArray) -> StructuredArray:
    array.setflags(write=False)  # a record is no measure's to change
    return array.view(Records)


class Run(Struct, frozen=True, kw_only=True, eq=False):
    """What a log says.

    Args:
        arrays: topic to records in the order of the log; field ``t_ns`` (nominal session time) first, then the fields of the
            topic's schema. Raw frames have the field ``data`` of bytes objects. A topic without records has length 0. The arrays
            are read only; those of a long log are mapped from a file.
        schemas: topic to schema, with the units.
        events: records of ``/events``; see ``records.EVENT_SCHEMA``.
        metadata: ``experiment``, ``seed``, ``clock``, ``link``, ``format`` (all text) and what else the record ``hilrig`` holds.
        versions, session: packages of the session, and what a session in real time said of itself.
        codes: names behind the records' small integers.
        experiment_text: the experiment file.
        resolved, certificate: the experiment after defaults and overrides; the design's certificate, empty if there is none.
        summary: the summary that closed the log, empty if it was never closed.
        start_ns: wall-clock instant of session time 0, ns since 1970; 0 in virtual time and where the log does not say.
    """

    arrays: MutableMapping[str, StructuredArray]
    schemas: dict[str, Schema]
    events: list[dict[str, Any]] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    session: dict[str, str] = field(default_factory=dict)
    codes: dict[str, list[str]] = field(default_factory=dict)
    experiment_text: str = ""
    resolved: dict[str, Any] = field(default_factory=dict)
    certificate: dict[str, Any] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)
    start_ns: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.arrays, Arrays):
            force_setattr(self, "arrays", Arrays(self.arrays))

    @classmethod
    def from_memory(cls, sink: MemorySink, **about: Any) -> Run:
        """Run of what a ``MemorySink`` kept; ``about`` takes the fields that a sink does not know, by name."""
        schemas = {topic: sink.channels[topic].schema for topic in sink.payloads if topic != EVENTS_TOPIC}
        arrays = {topic: assemble(schema, sink.payloads[topic], times=sink.times[topic]) for topic, schema in schemas.items()}
        return cls(arrays=arrays, schemas=schemas, events=decode_events(sink.payloads.get(EVENTS_TOPIC, ())), **about)

    def needs(self, *topics: str) -> None:
        """Ask for topics before reading them.

        Raises:
            MissingTopic: the log lacks one of them; the message says who writes it, and since when.
        """
        for topic in topics:
            if topic not in self.arrays:
                raise missing(topic, [*self.arrays])

    def pieces(self, topic: str, rows: int = ROWS) -> Iterator[StructuredArray]:
        """Give the records of a topic piece by piece: a long log is never whole in memory."""
        self.needs(topic)
        return cast(Arrays, self.arrays).pieces(topic, rows)

    def numbers(self, topic: str) -> StructuredArray:
        """Return the records of a topic; those of raw frames may lack the field ``data``."""
        self.needs(topic)
        return cast(Arrays, self.arrays).numbers(topic)


def records_sha256(run: Run) -> str:
    """Return the SHA-256 of every record of every topic but ``/events``: topic, field and bits, in the order of their names.

    In virtual time it is the same on every machine, for one experiment and one seed.

    A log also says which packages and commit made it, and holds a certificate, of which a solver may have made numbers; the
    SHA-256 of the file covers these too.
    """
    digest = hashlib.sha256()
    for topic in sorted(run.schemas):
        records = run.numbers(topic)
        if not len(records):
            continue
        for name in next(run.pieces(topic)).dtype.names or ():
            digest.update(f"{topic} {name} {len(records)}\n".encode())
            for piece in run.pieces(topic):  # a long log is never whole in memory
                digest.update(_bytes_of(piece, name))
    return digest.hexdigest()


def _bytes_of(records: StructuredArray, name: str) -> bytes:
    column = records[name]
    if column.dtype.hasobject:  # raw frames, of any length
        return b"".join(len(data).to_bytes(4, "little") + bytes(data) for data in column.tolist())
    return column.astype(column.dtype.newbyteorder("<")).tobytes()
