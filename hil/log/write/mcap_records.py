"""Records of an MCAP file as bytes: those that are no messages one by one, as `mcap.records` writes them, and messages in rows.

That package makes 16 dataclasses when it is imported, and three small writes of every number: what one run writes costs it 3 %
of the CPU time of a short run, this a tenth of that. Reading is left to the package.

Several messages in a row are one row of numbers, which is put between their heads when the chunk ends. A loop packs what changes,
and no more: the time, the numbers, and at most one frame. Heads, lengths and channels are the same in every row of a layout;
numpy writes them for a whole chunk.

Reference: the MCAP format specification, https://mcap.dev/spec, "Records".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from hil.log.records import CDR_HEADER, Schema
from hil.log.write.pipe_sink import ByFrameLength

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(0x01, 0x09)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(0x09, 0x10)

_RECORD: Final = struct.Struct("<BQ")
_LENGTH: Final = struct.Struct("<I")
_LONG: Final = struct.Struct("<Q")

MAGIC: Final = b"\x89MCAP0\r\n"
"""What an MCAP file begins and ends with."""

HEAD: Final = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time, publish time."""

MESSAGE_OVERHEAD: Final = HEAD.size
"""Bytes of a message beside its payload."""

BEHIND: Final = MESSAGE_OVERHEAD - 9
"""What the length of a message counts of its head."""

TIMES_AT: Final = 15
"""Where in a head its two times begin."""

_TIMES: Final = MESSAGE_OVERHEAD - TIMES_AT

BEGIN: Final = np.uint64(40)
"""Bits of a place, see `places`, that say where in its chunk a message begins: chunks are shorter than a TB."""

WITHIN: Final = np.uint64((1 << int(BEGIN)) - 1)

Integers = npt.NDArray[np.uint64]
Voids = npt.NDArray[np.void]


def record(opcode: int, *parts: bytes) -> bytes:
    """Return a record: its opcode, its length, what is in it."""
    return b"".join((_RECORD.pack(opcode, sum(map(len, parts))), *parts))


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
    return data + _LENGTH.pack(zlib.crc32(memoryview(data)[_RECORD.size :]))


def attachment_index(offset: int, length: int, log_ns: int, created_ns: int, size: int, name: str, media_type: str) -> bytes:
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


class Layout(msgspec.Struct, frozen=True, eq=False):
    """What is known of a row, and how rows become messages.

    Args:
        places: of each message, see `places`.
        size: of all their bytes.
        width: bytes of a row.
        time_at: where in a row its time stands, 64 bits, ns.
        spread: turns rows, one behind the other, into their messages, (n,); None where a row is a message already.
    """

    places: Integers
    size: int
    width: int
    time_at: int
    spread: Callable[[bytes], Voids] | None = None


def places(channels: Sequence[int], begins: Sequence[int]) -> Integers:
    """Return where messages begin, in numbers that sort by channel, then by place: channel 2^40 + begin."""
    return np.array(channels, np.uint64) << BEGIN | np.array(begins, np.uint64)


Made = tuple[Callable[..., bytes], Layout]
"""What packs a row, its time twice and then its values, and the layout of the row."""


def layouts(records: Sequence[tuple[int, Schema]]) -> ByFrameLength[Made]:
    """Return what packs some records in a row, and its layout, for every length of the frame among them.

    Args:
        records: channel and schema of each, in order; one of them at most has a frame.
    """

    def made(length: int) -> Made:
        mould, codes, begins = b"", "qq", []
        copies: list[tuple[int, int, int]] = []  # to where in the messages, from where to where in a row
        for number, schema in records:
            own, frame = schema.codes + (f"{-schema.dtype.itemsize % 4}x" if schema.raw else ""), schema.raw
            begins.append(len(mould))
            copies.append((len(mould) + TIMES_AT, 0, _TIMES))
            at, width = len(mould) + MESSAGE_OVERHEAD + len(CDR_HEADER), struct.calcsize(f"<{own}")
            begin = struct.calcsize(f"<{codes}")
            copies.append((at, begin, begin + width))
            tail = struct.pack("<I", length) if frame else b""
            if frame:
                copies.append((at + width + len(tail), begin + width, begin + width + length))
            behind = len(CDR_HEADER) + width + len(tail) + length * frame
            mould += HEAD.pack(MESSAGE, BEHIND + behind, number, 0, 0, 0) + CDR_HEADER + bytes(width) + tail
            mould += bytes(length * frame)
            codes += own + (f"{length}s" if frame else "")
        where = places([number for number, _ in records], begins)
        row = struct.Struct(f"<{codes}")
        return row.pack, Layout(where, len(mould), row.size, 0, _spreader(mould, copies, row.size))

    return ByFrameLength([(len(schema.codes), schema.raw) for _, schema in records], made)


def _spreader(mould: bytes, copies: Sequence[tuple[int, int, int]], width: int) -> Callable[[bytes], Voids]:
    """Return what copies from rows of a width what belongs into the mould."""
    names = [f"part{i}" for i in range(len(copies))]
    formats = [f"V{end - begin}" for _, begin, end in copies]
    begins, aims = [begin for _, begin, _ in copies], [at for at, _, _ in copies]
    source = np.dtype({"names": names, "formats": formats, "offsets": begins, "itemsize": width})
    target = np.dtype({"names": names, "formats": formats, "offsets": aims, "itemsize": len(mould)})

    def spread(rows: bytes) -> Voids:
        own = np.frombuffer(rows, source)
        out = np.frombuffer(bytearray(mould * len(own)), target)
        for name in names:
            out[name] = own[name]
        return out.view(f"V{len(mould)}")

    return spread
