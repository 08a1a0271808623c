"""MCAP records to bytes: what `mcap.writer.Writer` writes, byte for byte, with the messages of a chunk put together at once.

The package writes a message with some fifteen small writes. Here one `struct` packs the numbers of several messages, and numpy
writes their heads, and the index of a chunk, when the chunk ends.

Reference: the MCAP format specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final, Literal, Protocol

import numpy as np
import zstandard

from hil.log.append_column import AppendColumn, pieces
from hil.log.write import mcap_records as mcap
from hil.log.write.mcap_records import BEHIND, HEAD, LENGTH, MAGIC, behind_length, record
from hil.log.write.open_chunk import Messages, OpenChunk

Index = Literal["full", "chunk"]
"""How much of an index a log has."""

COMPRESSION: Final = "zstd"

INDEX_PIECE: Final = 1 << 18
"""Bytes of the chunks' index that are written together: it has some 6 bytes for every slot of a run."""

INDEX_WAITING: Final = 1 << 16
"""Bytes of it that wait in memory: in real time a chunk ends 20 times a second, and what holds its place must not add up."""

_INDEX_HEAD: Final = struct.Struct("<BQHI")
_OF_CHANNEL: Final = struct.Struct("<HQ")


class Stream(Protocol):
    """Where the bytes go."""

    def write(self, data: bytes, /) -> int: ...

    def tell(self) -> int: ...

    def flush(self) -> None: ...


SHORTEST: Final = 10  # binary digits of the lengths that have the first context of zstd


class Compressor:
    """zstd that takes its memory once: what it has does not follow the bursts of what it gets.

    One context of zstd takes what the longest data so far asked for, and from its 129th use on it gives back what is more than
    three times that of the next. A session whose chunks differ in length would grow and shrink by 0.9 MB. Here every length has
    the context of its power of two. Chunks are compressed each by itself, to the frames that one context makes.

    Args:
        room: bytes up to which a chunk finds all memory taken; longer ones take more when they come.

    Attributes:
        contexts: those of zstd, by the binary digits of a length.
    """

    def __init__(self, room: int) -> None:
        self.contexts: dict[int, zstandard.ZstdCompressor] = {}
        for digits in range(SHORTEST, max(room - 1, 0).bit_length() + 1):
            for data in _touching(1 << digits):
                self._context(digits).compress(data)

    def compress(self, data: bytes) -> bytes:
        """Return a frame of zstd."""
        return self._context(max(SHORTEST, (len(data) - 1).bit_length())).compress(data)

    def _context(self, digits: int) -> zstandard.ZstdCompressor:
        context = self.contexts.get(digits)
        if context is None:
            context = self.contexts[digits] = zstandard.ZstdCompressor()
        return context


def _touching(length: int) -> tuple[bytes, ...]:
    """Return data of which nothing repeats, and data of which much does, so that zstd writes to all of its memory."""
    rng = np.random.default_rng(0)
    return rng.bytes(length), rng.integers(0, 8, length, np.uint8).tobytes()


class McapWriter:
    """Writes one MCAP file: chunks compressed with zstd, every chunk indexed, all checksums.

    Args:
        stream: takes the bytes; those before a `flush` are as good as written, later ones may go to the disk or not.
        profile, library: what the header says.
        index: `full` has where in its chunk every message stands; `chunk` has the chunks only.
        chunk_ended: called with every chunk that is written: its bytes, and where its messages stand in them.
        folder: where the chunks' index of a long run is kept until the end, see `AppendColumn`.
        room: bytes of the longest chunk, see `Compressor`.

    Attributes:
        chunk: the open chunk, which takes messages.
        start_ns: log time of time 0 of `messages_of`.
        behind_ns: how much after its log time happened what comes next, likewise.
    """

    def __init__(
        self,
        stream: Stream,
        *,
        profile: str,
        library: str,
        index: Index = "full",
        chunk_ended: Callable[[bytes, Messages], None] = lambda data, messages: None,
        folder: Path | None = None,
        room: int = 0,
    ) -> None:
        self._index = index
        self._chunk_ended = chunk_ended
        self._stream = stream
        self._compress = Compressor(room).compress
        self._data_crc = 0
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._metadata: list[bytes] = []  # where they stand, as the summary says it; so too the attachments
        self._attachments: list[bytes] = []
        self._chunks = 0
        self._chunk_indexes = AppendColumn(np.uint8, folder, INDEX_WAITING)  # as they will stand in the summary
        self._counts: dict[int, int] = {}
        self._start: int | None = None
        self._end = 0
        self._opening: list[bytes] = []  # schemas and channels that stand at the begin of the open chunk
        self.chunk = OpenChunk()
        self.start_ns = self.behind_ns = 0
        self._write(MAGIC)
        self._write(record(mcap.HEADER, profile, library))

    def _write(self, data: bytes) -> None:
        self._data_crc = zlib.crc32(data, self._data_crc)
        self._stream.write(data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        data = record(mcap.METADATA, name, values)
        self._metadata.append(record(mcap.METADATA_INDEX, struct.pack("<QQ", self._stream.tell(), len(data)), name))
        self._write(data)

    def add_attachment(self, name: str, media_type: str, content: bytes, *, create_time: int = 0, log_time: int = 0) -> None:
        """Write an attachment; times in ns."""
        times, length = struct.pack("<QQ", log_time, create_time), struct.pack("<Q", len(content))
        data = record(mcap.ATTACHMENT, times, name, media_type, length, content, bytes(LENGTH.size))[: -LENGTH.size]
        data += LENGTH.pack(zlib.crc32(memoryview(data)[mcap.RECORD.size :]))
        place = struct.pack("<QQ", self._stream.tell(), len(data))
        self._attachments.append(record(mcap.ATTACHMENT_INDEX, place, times, length, name, media_type))
        self._write(data)

    def register_schema(self, name: str, encoding: str, text: bytes) -> int:
        """Add a schema to the open chunk; return its number."""
        number = len(self._schemas) + 1
        self._schemas.append(record(mcap.SCHEMA, struct.pack("<H", number), name, encoding, behind_length(text)))
        self._opening.append(self._schemas[-1])
        return number

    def register_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str] | None = None) -> int:
        """Add a channel to the open chunk; return its number."""
        number = len(self._channels) + 1
        self._channels.append(record(mcap.CHANNEL, struct.pack("<HH", number, schema_id), topic, encoding, metadata or {}))
        self._opening.append(self._channels[-1])
        return number

    def messages_of(self, channel_id: int) -> Callable[[int, bytes], None]:
        """Return the function that adds a message of a channel to the open chunk: time in ns, 0 at least, and payload.

        The log time counts from `start_ns`, and the publish time lies `behind_ns` after it.
        """
        take, pack, opcode = self.chunk.add, HEAD.pack, mcap.MESSAGE

        def add(t_ns: int, payload: bytes) -> None:
            log_ns = self.start_ns + t_ns if t_ns > 0 else self.start_ns
            head = pack(opcode, BEHIND + len(payload), channel_id, 0, log_ns, max(log_ns + self.behind_ns, 0))
            take(channel_id, head + payload)

        return add

    def add_framed(self, channel_id: int, message: bytes) -> None:
        """Add a message as it stood in another file, head included, to the open chunk.

        Args:
            channel_id: its channel here.
            message: opcode, length, channel, and so on.
        """
        self.chunk.add(channel_id, message[:9] + channel_id.to_bytes(2, "little") + message[11:])

    @property
    def end_ns(self) -> int:
        """Time of the newest message in a chunk that has ended, counted from `start_ns`; 0 if there is none."""
        return max(self._end - self.start_ns, 0)

    def flush(self) -> None:
        """End the open chunk, if it has a message, and let everything go to the disk."""
        self._end_chunk()
        self._stream.flush()

    def _end_chunk(self) -> None:
        if not self.chunk.size:
            return
        opening = b"".join(self._opening)
        self._opening.clear()
        data, messages, first, last = self.chunk.end(opening)
        packed, at, span = self._compress(data), self._stream.tell(), struct.pack("<QQ", first, last)
        sizes = struct.pack("<QI", len(data), zlib.crc32(data))
        self._write(record(mcap.CHUNK, span, sizes, COMPRESSION, struct.pack("<Q", len(packed)), packed))
        place = struct.pack("<QQ", at, self._stream.tell() - at)
        indexes, offsets = self._indexes(messages)
        self._write(indexes)
        lengths = struct.pack("<QQ", len(packed), len(data))
        index = record(mcap.CHUNK_INDEX, span, place, offsets, struct.pack("<Q", len(indexes)), COMPRESSION, lengths)
        self._chunks += 1
        self._chunk_indexes.extend(np.frombuffer(index, np.uint8))
        self._start = first if self._start is None else min(self._start, first)
        self._end = max(self._end, last)
        self._chunk_ended(data, messages)

    def _indexes(self, messages: Messages) -> tuple[bytes, bytes]:
        """Return the message indexes of a chunk, and where in the file that of every channel begins."""
        found, offsets = [], b""
        begin = self._stream.tell()
        for channel, (times, begins) in messages.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(times)
            if self._index == "chunk":
                continue
            entries = np.empty((len(times), 2), "<u8")
            entries[:, 0], entries[:, 1] = times, begins
            offsets += _OF_CHANNEL.pack(channel, begin)
            found += [_INDEX_HEAD.pack(mcap.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes), entries.tobytes()]
            begin += _INDEX_HEAD.size + entries.nbytes
        return b"".join(found), behind_length(offsets)

    def finish(self) -> None:
        """Write the rest, the summary and the footer."""
        self._end_chunk()
        self._stream.write(record(mcap.DATA_END, LENGTH.pack(self._data_crc)))
        start = self._stream.tell()
        numbers = struct.pack(
            "<QHIIIIQQ", sum(self._counts.values()), len(self._schemas), len(self._channels), len(self._attachments),
            len(self._metadata), self._chunks, self._start or 0, self._end,
        )  # fmt: skip
        counted = b"".join(_OF_CHANNEL.pack(number, count) for number, count in self._counts.items())
        groups: tuple[tuple[int, Iterable[bytes]], ...] = (
            (mcap.SCHEMA, self._schemas),
            (mcap.CHANNEL, self._channels),
            (mcap.STATISTICS, (record(mcap.STATISTICS, numbers, behind_length(counted)),)),
            (mcap.CHUNK_INDEX, (piece.tobytes() for piece in pieces(self._chunk_indexes.array(), INDEX_PIECE))),
            (mcap.ATTACHMENT_INDEX, self._attachments),
            (mcap.METADATA_INDEX, self._metadata),
        )
        offsets, tail, crc = b"", start, 0
        for opcode, group in groups:
            begin = tail
            for data in group:
                self._stream.write(data)
                tail += len(data)
                crc = zlib.crc32(data, crc)
            offsets += record(mcap.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, begin, tail - begin))
        footer = record(mcap.FOOTER, struct.pack("<QQI", start, tail, 0))[: -LENGTH.size]
        crc = zlib.crc32(footer, zlib.crc32(offsets, crc))
        self._stream.write(offsets + footer + LENGTH.pack(crc) + MAGIC)
