"""The frames of the pipe between a loop and its log: a head, and behind it one record, or the values of several.

Head (little endian): u32 length of what follows, u16 number, i64 nominal time in ns, i64 how much later it happened in ns. The
number is that of a channel, 0 for events, or one of ours at the top: when session time 0 was, how many records the writer had to
drop, what is in a block, and that the writer ended in good order. A block has the values of one record of each of some channels,
in a row and without gaps: a loop packs them by one struct, and who reads makes records of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate
from struct import Struct, error
from typing import Any, Final, Generic, TypeVar

from hil.log.records import CDR_HEADER, Channel

HEAD: Final = Struct("<IHqq")
COUNT: Final = Struct("<Q")
"""What follows where the number says when session time 0 was, in ns since 1970, or how many records were dropped."""

EVENTS_ID: Final = 0
FIRST_BLOCK_ID: Final = 0x8000
"""Blocks are numbered from here on, channels below."""

BLOCK_ID: Final = 0xFFFC
"""Says what a block has: its number, and those of its channels, u16 each."""

BEGIN_ID: Final = 0xFFFD
END_ID: Final = 0xFFFE
DROPPED_ID: Final = 0xFFFF

_LENGTH: Final = Struct("<I")


_MOST: Final = 64  # the lengths of frames may come from the link

Made = TypeVar("Made")


class ByFrameLength(Generic[Made]):
    """Keeps what rows need whose frame has the same length.

    Args:
        records: of each, in order, how many numbers it has, and whether a frame follows them.
        make: makes it for a length in bytes, 0 for rows without a frame.

    Attributes:
        count: values of a row.
        frame_at: which of them is the frame, None without one.

    Raises:
        ValueError: two of the records carry frames.
    """

    __slots__ = ("_made", "_make", "count", "frame_at")

    def __init__(self, records: Sequence[tuple[int, bool]], make: Callable[[int], Made]) -> None:
        frames = sum(frame for _, frame in records)
        if frames > 1:
            raise ValueError(f"records: {frames} carry frames, expected one at most")
        ends = [0, *accumulate(numbers + frame for numbers, frame in records)]
        self.count = ends[-1]
        self.frame_at = next((end - 1 for end, (_, frame) in zip(ends[1:], records) if frame), None)
        self._make = make
        self._made: dict[int, Made] = {}

    def of(self, length: int) -> Made:
        """Return it for frames of that length, bytes."""
        made = self._made.get(length)
        if made is None:
            if len(self._made) >= _MOST:
                self._made.clear()
            made = self._made[length] = self._make(length)
        return made


class PipeBlock:
    """Packs one record of each of some channels at once, without what is the same in all of them.

    Args:
        number: of the block in the pipe.
        channels: in order; one of them at most carries frames.

    Raises:
        ValueError: two of them carry frames.
    """

    def __init__(self, number: int, channels: Sequence[Channel]) -> None:
        self.number, self.messages = number, len(channels)
        codes = [(channel.schema.codes, channel.schema.raw) for channel in channels]

        def layout(length: int) -> tuple[Callable[..., bytes], int]:
            row = Struct(HEAD.format + "".join(own + (f"{length}s" if raw else "") for own, raw in codes))
            return row.pack, row.size - HEAD.size

        self._made = ByFrameLength([(len(own), raw) for own, raw in codes], layout)
        self._values, self._frame_at = self._made.count, self._made.frame_at

    def pack(self, t_ns: int, behind_ns: int, values: Sequence[Any]) -> bytes:
        """Return the records as they go into the pipe.

        Args:
            t_ns: nominal time of all of them, ns.
            behind_ns: how much later they happened, ns.
            values: the numbers of the first record, of the second, and so on; the bytes of a frame stand behind its numbers.

        Raises:
            TypeError: not as many values as the records have.
        """
        at = self._frame_at
        try:
            pack, size = self._made.of(0 if at is None else len(values[at]))
            return pack(size, self.number, t_ns, behind_ns, *values)
        except (error, LookupError, TypeError):
            if len(values) != self._values:
                raise TypeError(f"{len(values)} values, expected {self._values} in {self.messages} records") from None
            raise


class BlockRecords:
    """Makes records of a block again.

    Args:
        channels: as they were packed.
    """

    def __init__(self, channels: Sequence[Channel]) -> None:
        self._parts = [(channel.schema.dtype.itemsize, channel.schema.raw) for channel in channels]
        self._numbers = sum(width for width, _ in self._parts)
        self._raw = any(raw for _, raw in self._parts)

    def payloads(self, data: bytes) -> list[bytes] | None:
        """Return the payload of each record, in order; None where bytes are no such block."""
        length, at, found = len(data) - self._numbers, 0, []
        if length < 0 or (length and not self._raw):
            return None
        for width, raw in self._parts:
            payload = CDR_HEADER + data[at : at + width]
            at += width
            if raw:
                payload += bytes(-width % 4) + _LENGTH.pack(length) + data[at : at + length]
                at += length
            found.append(payload)
        return found
