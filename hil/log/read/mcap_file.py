"""An MCAP file that is open for reading: what it is, how long it is, and what it holds, without a copy of each message.

It serves the reading of a run and the recovery of one. The records of a topic are gathered as columns, chunk by chunk: what is
kept is numbers, not a Python object for each record. Those of a long log grow in files without a name (`hil.log.append_column`),
so that memory does not grow with the log.
"""

from __future__ import annotations

import os
import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from msgspec import Struct, field

from hil.errors import HilError, located
from hil.files import open_regular
from hil.log.append_column import ROWS, AppendColumn, pieces, release
from hil.log.read import mcap_walk
from hil.log.read.mcap_walk import MESSAGE_PAYLOAD_AT, MESSAGE_TIME_AT, Record
from hil.log.records import TIME_FIELD
from hil.log.records import Schema as Layout
from hil.log.run import StructuredArray, assemble, run_dtype
from hil.log.topics import CONTROL, TIMING


@contextmanager
def open_mcap(path: Path, descriptor: int | None = None) -> Iterator[tuple[BinaryIO, int]]:
    """Give a file that begins as MCAP does, and its length in bytes.

    Args:
        path: the file, for opening and for messages.
        descriptor: the file, open already (its name may be gone); it stays open.

    Raises:
        HilError: if it cannot be read, is no regular file (a device has no end), is empty, or begins otherwise.
    """
    log = open_regular(path, "an MCAP log", descriptor=descriptor, buffering=1 << 18)
    with located(f"{path}: cannot be read", OSError), log as file:
        head = file.read(len(mcap_walk.MAGIC))
        if not head:
            raise HilError(f"{path}: is empty, expected an MCAP log")
        if head != mcap_walk.MAGIC:
            raise HilError(f"{path}: is no MCAP file: byte 0 begins {head!r}, expected {mcap_walk.MAGIC!r}")
        yield file, os.fstat(file.fileno()).st_size


LATEST_START_NS = 1 << 62  # the year 2116


def start_instant(clock: Mapping[str, str]) -> int | None:
    """Return when session time 0 was, as the metadata record `clock` says, ns since 1970; None if it says no instant."""
    said = clock.get("start_ns", "")
    return int(said) if said.isascii() and said.isdecimal() and len(said) <= 19 and int(said) < LATEST_START_NS else None


class Content(Struct, kw_only=True):
    """Records by kind; a message stays whole, framing included (time at byte 15, payload from byte 31).

    Args:
        schemas, channels: by number; the first copy that can be read counts.
        messages: by number of the channel, in the order of the file; the reader may take them out.
        metadata: by name; a later record of one name replaces an earlier one.
        attachments: by name.
        budget: how much the file may unpack to.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: defaultdict[int, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    budget: mcap_walk.Budget

    def take(self, record: Record) -> None:
        """Take one record of the file; indexes and statistics are passed over.

        Raises:
            DamagedRecord: if the record cannot be read; no message of it was taken then.
        """
        if record.opcode == Opcode.CHUNK:
            self._take_chunk(mcap_walk.unpack_chunk(record, self.budget), record)
        elif record.opcode == Opcode.SCHEMA:
            schema = mcap_walk.parse(Schema.read, record)
            self.schemas.setdefault(schema.id, schema)
        elif record.opcode == Opcode.CHANNEL:
            channel = mcap_walk.parse(Channel.read, record)
            self.channels.setdefault(channel.id, channel)
        elif record.opcode == Opcode.METADATA:
            metadata = mcap_walk.parse(Metadata.read, record)
            self.metadata[metadata.name] = metadata.metadata
        elif record.opcode == Opcode.ATTACHMENT:
            attachment = mcap_walk.parse_attachment(record)
            self.attachments[attachment.name] = attachment
        elif record.opcode == Opcode.MESSAGE:
            whole = struct.pack("<BQ", record.opcode, len(record.body)) + record.body
            self._take_chunk(whole, record)

    def _take_chunk(self, content: bytes, record: Record) -> None:
        messages: defaultdict[int, list[bytes]] = defaultdict(list)
        for opcode, channel, at, after in mcap_walk.framed(content, record):
            if opcode == Opcode.MESSAGE:
                messages[channel].append(content[at:after])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.take(Record(record.offset, opcode, memoryview(content)[at + 9 : after]))
        for channel, found in messages.items():
            self.messages[channel] += found


TOGETHER: Final = 4096
"""Messages that are turned into numbers together."""


class Columns:
    """One topic's records, in the order of the log.

    Args:
        topic: its name, for messages.
        schema: of its records.
        folder: where those of a long log are kept.
        start_ns: log time of session time 0, ns.

    Attributes:
        records: how many there are.
        extremes: least and largest number of the fields that say in which slot and at what time. A control frame may come from
            anyone, and says what slot it likes.
    """

    def __init__(self, topic: str, schema: Layout, folder: str | os.PathLike[str] | None = None, start_ns: int = 0) -> None:
        self._topic, self.schema = topic, schema
        self._start_ns = start_ns
        self._messages: list[bytes] = []
        self.records = 0
        self.extremes: dict[str, tuple[float, float]] = {}
        checked = {TIMING.name: ("slot", "lateness_us", "round_trip_us"), CONTROL.name: ()}.get(topic, ("slot",))
        self._checked = [each.name for each in schema.fields if each.name in checked]
        self._dtype = run_dtype(schema)
        self._raw = schema.fields[-1].name if schema.raw else None
        self._numbers = AppendColumn([(name, self._dtype[name]) for name in self._dtype.names or () if name != self._raw], folder)
        self._lengths, self._bytes = AppendColumn(np.int64, folder), AppendColumn(np.uint8, folder)

    def add(self, messages: list[bytes]) -> None:
        """Take messages, framing included.

        Raises:
            HilError: if one is not as the schema says.
        """
        self._messages += messages
        if len(self._messages) >= TOGETHER:
            self.finish()

    def finish(self) -> None:
        """Turn what was taken into numbers.

        Raises:
            HilError: if a message is not as the schema says.
        """
        if not self._messages:
            return
        with located(f"topic {self._topic}", HilError):
            found = assemble(self.schema, self._messages, payload_at=MESSAGE_PAYLOAD_AT, time_at=MESSAGE_TIME_AT)
        self._messages = []
        found[TIME_FIELD] -= self._start_ns
        self.records += len(found)
        for name in self._checked:
            own = found[name]
            if name != "slot":  # without an answer there is no round trip
                own = np.where(np.isnan(own), 0.0 if name == "round_trip_us" else np.inf, own)
            least, largest = self.extremes.get(name, (own[0].item(), own[0].item()))
            self.extremes[name] = min(least, own.min().item()), max(largest, own.max().item())
        if self._raw is None:
            self._numbers.extend(found)
            return
        data = found[self._raw].tolist()
        self._numbers.extend(found[[*(self._numbers.dtype.names or ())]].astype(self._numbers.dtype))
        self._lengths.extend(np.array([len(each) for each in data], np.int64))
        self._bytes.extend(np.frombuffer(b"".join(data), np.uint8))

    def numbers(self) -> StructuredArray:
        """Return all records without what is raw."""
        return self._numbers.array()

    def pieces(self, rows: int = ROWS) -> Iterator[StructuredArray]:
        """Give the records piece by piece, raw frames as bytes objects."""
        numbers = self.numbers()
        if self._raw is None:
            yield from pieces(numbers, rows)
            return
        lengths, data, at = self._lengths.array(), self._bytes.array(), 0
        for start in range(0, len(numbers), rows):
            part, sizes = numbers[start : start + rows], lengths[start : start + rows]
            out = np.empty(len(part), self._dtype)
            for name in part.dtype.names or ():
                out[name] = part[name]
            ends = at + np.cumsum(sizes)
            content = data[at : int(ends[-1])].tobytes()
            frames = out[self._raw]
            for i, (end, size) in enumerate(zip((ends - at).tolist(), sizes.tolist())):
                frames[i] = content[end - size : end]
            at = int(ends[-1])
            yield out
            for column in (numbers, lengths, data):
                release(column)

    def array(self) -> StructuredArray:
        """Return all records as one array."""
        if self._raw is None:
            return self.numbers()
        parts = [*self.pieces()]
        return parts[0] if len(parts) == 1 else np.concatenate(parts) if parts else np.empty(0, self._dtype)
