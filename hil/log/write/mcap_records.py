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
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from hil.log.records import CDR_HEADER, Schema
from hil.log.write.pipe_sink import ByFrameLength

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(0x01, 0x09)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(0x09, 0x10)

RECORD: Final = struct.Struct("<BQ")
LENGTH: Final = struct.Struct("<I")

MAGIC: Final = b"\x89MCAP0\r\n"
"""What an MCAP file begins and ends with."""

HEAD: Final = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time, publish time."""

MESSAGE_OVERHEAD: Final = HEAD.size
"""Bytes of a message beside its payload."""

BEHIND: Final = MESSAGE_OVERHEAD - RECORD.size
"""What the length of a message counts of its head."""

TIMES_AT: Final = 15
"""Where in a head its two times begin."""

_TIMES: Final = MESSAGE_OVERHEAD - TIMES_AT

BEGIN: Final = np.uint64(40)
"""Bits of a place, see `places`, that say where in its chunk a message begins: chunks are shorter than a TB."""

WITHIN: Final = np.uint64((1 << int(BEGIN)) - 1)

Integers = npt.NDArray[np.uint64]
Voids = npt.NDArray[np.void]


def record(opcode: int, *parts: bytes | str | Mapping[str, str]) -> bytes:
    """Return a record: its opcode, its length, what is in it; texts and tables of texts stand behind their lengths."""
    data = [*map(_bytes, parts)]
    return b"".join((RECORD.pack(opcode, sum(map(len, data))), *data))


def _bytes(part: bytes | str | Mapping[str, str]) -> bytes:
    if isinstance(part, bytes):
        return part
    return behind_length(part.encode() if isinstance(part, str) else b"".join(map(_bytes, chain(*part.items()))))


def behind_length(data: bytes) -> bytes:
    """Return bytes with their number, 32 bits, before them."""
    return LENGTH.pack(len(data)) + data


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
            tail = LENGTH.pack(length) if frame else b""
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
