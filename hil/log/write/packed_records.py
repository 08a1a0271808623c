"""Several MCAP messages in a row as one row of numbers, which is put between their heads when the chunk ends.

A loop packs what changes, and no more: the time, the numbers, and at most one frame. Heads, lengths and channels are the same in
every row of a layout; numpy writes those of a whole chunk at once.

Reference: the MCAP format specification, https://mcap.dev/spec, "Message".
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from hil.log.write.mcap_records import MESSAGE
from hil.log.write.pipe_block import ByFrameLength

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

WITHIN: Final = np.uint64((1 << 40) - 1)

Integers = npt.NDArray[np.uint64]
Voids = npt.NDArray[np.void]


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


class Packed(NamedTuple):
    """How the records of a channel are packed.

    Attributes:
        channel_id: the channel.
        before: bytes of the payload before the numbers.
        codes: the numbers, as `struct` writes them.
        values: how many numbers.
        frame: whether the u32 length of a frame and the frame follow.
    """

    channel_id: int
    before: bytes
    codes: str
    values: int
    frame: bool


Made = tuple[Callable[..., bytes], Layout]
"""What packs a row, its time twice and then its values, and the layout of the row."""


class Layouts:
    """The layouts of some records in a row, one for every length of the frame among them.

    Args:
        records: in order; one of them at most has a frame.

    Attributes:
        messages: how many.
        count: values of a row.
        frame_at: which of them is the frame, None without one.
        of: what packs a row with a frame of a length, and its layout.
    """

    def __init__(self, records: Sequence[Packed]) -> None:
        self._records = tuple(records)
        self.messages = len(self._records)
        made = ByFrameLength([(record.values, record.frame) for record in self._records], self._make)
        self.count, self.frame_at, self.of = made.count, made.frame_at, made.of

    def _make(self, length: int) -> Made:
        mould, codes, begins = b"", "qq", []
        copies: list[tuple[int, int, int]] = []  # to where in the messages, from where to where in a row
        for number, before, own, _, frame in self._records:
            begins.append(len(mould))
            copies.append((len(mould) + TIMES_AT, 0, _TIMES))
            at, width = len(mould) + MESSAGE_OVERHEAD + len(before), struct.calcsize(f"<{own}")
            begin = struct.calcsize(f"<{codes}")
            copies.append((at, begin, begin + width))
            tail = struct.pack("<I", length) if frame else b""
            if frame:
                copies.append((at + width + len(tail), begin + width, begin + width + length))
            behind = len(before) + width + len(tail) + length * frame
            mould += HEAD.pack(MESSAGE, BEHIND + behind, number, 0, 0, 0) + before + bytes(width) + tail
            mould += bytes(length * frame)
            codes += own + (f"{length}s" if frame else "")
        where = places([record.channel_id for record in self._records], begins)
        row = struct.Struct(f"<{codes}")
        return row.pack, Layout(where, len(mould), row.size, 0, _spreader(mould, copies, row.size))


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
