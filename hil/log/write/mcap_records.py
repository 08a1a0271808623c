"""Records of an MCAP file that are no messages, as bytes: as `mcap.records` writes them.

That package makes 16 dataclasses when it is imported, and three small writes of every number: what one run writes costs it 3 %
of the CPU time of a short run, this a tenth of that. Reading is left to the package.

Reference: the MCAP format specification, https://mcap.dev/spec, "Records".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import Final

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(0x01, 0x09)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(0x09, 0x10)

_HEAD: Final = struct.Struct("<BQ")
_LENGTH: Final = struct.Struct("<I")
_LONG: Final = struct.Struct("<Q")


def record(opcode: int, *parts: bytes) -> bytes:
    """Return a record: its opcode, its length, what is in it."""
    return b"".join((_HEAD.pack(opcode, sum(map(len, parts))), *parts))


def _text(text: str) -> bytes:
    data = text.encode()
    return _LENGTH.pack(len(data)) + data


def _table(values: Mapping[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in values.items())
    return _LENGTH.pack(len(data)) + data


def header(profile: str, library: str) -> bytes:
    """Return the first record."""
    return record(HEADER, _text(profile), _text(library))


def schema(number: int, name: str, encoding: str, text: bytes) -> bytes:
    """Return what a record of a topic is made of."""
    return record(SCHEMA, struct.pack("<H", number), _text(name), _text(encoding), _LENGTH.pack(len(text)), text)


def channel(number: int, schema_id: int, topic: str, encoding: str, said: Mapping[str, str]) -> bytes:
    """Return the channel of a topic, with what it says of itself."""
    return record(CHANNEL, struct.pack("<HH", number, schema_id), _text(topic), _text(encoding), _table(said))


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    """Return a named table of texts."""
    return record(METADATA, _text(name), _table(values))


def metadata_index(offset: int, length: int, name: str) -> bytes:
    """Return where metadata stand, bytes."""
    return record(METADATA_INDEX, struct.pack("<QQ", offset, length), _text(name))


def attachment(log_ns: int, created_ns: int, name: str, media_type: str, content: bytes) -> bytes:
    """Return a file, with its checksum."""
    data = record(
        ATTACHMENT, struct.pack("<QQ", log_ns, created_ns), _text(name), _text(media_type), _LONG.pack(len(content)), content,
        bytes(_LENGTH.size),
    )[: -_LENGTH.size]  # fmt: skip
    return data + _LENGTH.pack(zlib.crc32(memoryview(data)[_HEAD.size :]))


def attachment_index(
    offset: int, length: int, log_ns: int, created_ns: int, size: int, name: str, media_type: str
) -> bytes:
    """Return where a file stands, and how long it is itself, bytes."""
    return record(ATTACHMENT_INDEX, struct.pack("<5Q", offset, length, log_ns, created_ns, size), _text(name), _text(media_type))


def chunk(first_ns: int, last_ns: int, data: bytes, compression: str, packed: bytes) -> bytes:
    """Return a chunk of messages: their first and last time, their bytes as they are, and how and to what they are packed."""
    sizes = struct.pack("<QQQI", first_ns, last_ns, len(data), zlib.crc32(data))
    return record(CHUNK, sizes, _text(compression), _LONG.pack(len(packed)), packed)


def chunk_index(
    first_ns: int, last_ns: int, offset: int, length: int, indexes: Mapping[int, int], indexes_length: int, compression: str,
    packed: int, size: int,
) -> bytes:  # fmt: skip
    """Return where a chunk stands, and of every channel its index; lengths in bytes.

    Args:
        first_ns, last_ns: times of its messages.
        offset, length: of the chunk's record.
        indexes: channel to where in the file its index begins.
        indexes_length: of all of them.
        compression: of the chunk.
        packed, size: of its messages, compressed and as they are.
    """
    entries = b"".join(struct.pack("<HQ", number, at) for number, at in indexes.items())
    return record(
        CHUNK_INDEX, struct.pack("<QQQQI", first_ns, last_ns, offset, length, len(entries)), entries, _LONG.pack(indexes_length),
        _text(compression), struct.pack("<QQ", packed, size),
    )  # fmt: skip


def statistics(
    first_ns: int, last_ns: int, schemas: int, attachments: int, metadata: int, chunks: int, counts: Mapping[int, int],
    channels: int,
) -> bytes:  # fmt: skip
    """Return how many there are of each; `counts` of the messages, by their channels."""
    counted = b"".join(struct.pack("<HQ", number, count) for number, count in counts.items())
    numbers = struct.pack(
        "<QHIIIIQQI", sum(counts.values()), schemas, channels, attachments, metadata, chunks, first_ns, last_ns, len(counted)
    )
    return record(STATISTICS, numbers, counted)


def summary_offset(opcode: int, begin: int, length: int) -> bytes:
    """Return where in the summary the records of one kind stand."""
    return record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, begin, length))


def data_end(crc: int) -> bytes:
    """Return the end of the data, with the checksum of all before."""
    return record(DATA_END, _LENGTH.pack(crc))


def footer(summary: int, offsets: int, crc: int) -> bytes:
    """Return the last record: where the summary and its offsets begin, and the checksum of both."""
    return record(FOOTER, struct.pack("<QQI", summary, offsets, crc))
