"""Several MCAP messages in a row as one `struct`: heads, numbers and at most one frame.

Reference: the MCAP format specification, https://mcap.dev/spec, "Message".
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from operator import itemgetter
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode

HEAD: Final = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time, publish time."""

MESSAGE_OVERHEAD: Final = HEAD.size
"""Bytes of a message beside its payload."""

BEHIND: Final = MESSAGE_OVERHEAD - 9
"""What the length of a message counts of its head."""

_TIMES_AT: Final = 15
_MAX_LAYOUTS: Final = 64  # the lengths of frames may come from the link


Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Messages:
    """The messages of one chunk, in order.

    Args:
        channels: number of the channel of each.
        times: log time of each, ns.
        begins: where in the chunk the head of each begins.
    """

    channels: Integers
    times: Integers
    begins: Integers


Part = tuple[int, tuple[int, ...], tuple[int, ...]]
"""What is known of some messages in a row: their time in ns, channel and size of each."""


def messages_at(begin: int, parts: Sequence[Part]) -> Messages:
    """Return the messages of a chunk, the first of which begins there.

    Args:
        begin: bytes before the first message.
        parts: at least one.

    >>> messages_at(10, [(5, (1, 2), (40, 50)), (6, (1,), (40,))]).begins.tolist()
    [10, 50, 100]
    """
    times, channels, sizes = zip(*parts)
    counts = np.fromiter(map(len, sizes), np.int64, len(sizes))
    count = int(counts.sum())
    ends = np.cumsum(np.fromiter(chain.from_iterable(sizes), np.int64, count))
    begins = np.empty(count, np.int64)
    begins[0] = begin
    begins[1:] = begin + ends[:-1]
    return Messages(
        channels=np.fromiter(chain.from_iterable(channels), np.int64, count),
        times=np.repeat(np.fromiter(times, np.int64, len(times)), counts),
        begins=begins,
    )


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


class _Layout(NamedTuple):
    """Some messages in a row, packed by one `struct`: what packs, what puts time, constants and values in order, and sizes."""

    pack: Callable[..., bytes]
    pick: Callable[[tuple[Any, ...]], tuple[Any, ...]]
    constants: tuple[Any, ...]
    channels: tuple[int, ...]
    sizes: tuple[int, ...]
    size: int


class Layouts:
    """The layouts of some records in a row, one for every length of the frame among them."""

    def __init__(self, records: Sequence[Packed]) -> None:
        if sum(record.frame for record in records) > 1:
            raise ValueError(f"records: {sum(record.frame for record in records)} frames, expected one at most")
        self._records = tuple(records)
        self._made: dict[int, _Layout] = {}
        self.count = sum(record.values + record.frame for record in records)
        ends = accumulate(record.values + record.frame for record in records)
        self.frame_at = next((end - 1 for end, record in zip(ends, records) if record.frame), None)

    def of(self, length: int) -> _Layout:
        """Return the layout with a frame of that length."""
        made = self._made.get(length)
        if made is None:
            if len(self._made) >= _MAX_LAYOUTS:
                self._made.clear()
            made = self._made[length] = self._make(length)
        return made

    def _make(self, length: int) -> _Layout:
        constants: list[Any] = []
        order, sizes, codes = [], [], ""
        value = 1 + sum(3 if record.frame else 2 for record in self._records)  # behind the time and the constants
        for number, before, own, values, frame in self._records:
            tail = f"I{length}s" if frame else ""
            behind = struct.Struct(f"<{len(before)}s{own}{tail}").size
            head = HEAD.pack(Opcode.MESSAGE, BEHIND + behind, number, 0, 0, 0)[:_TIMES_AT]
            order += [1 + len(constants), 0, 0, 2 + len(constants), *range(value, value + values)]
            constants += [head, before]
            value += values
            if frame:
                constants.append(length)
                order += [len(constants), value]
                value += 1
            codes += f"{_TIMES_AT}sQQ{len(before)}s{own}{tail}"
            sizes.append(MESSAGE_OVERHEAD + behind)
        layout = struct.Struct(f"<{codes}")
        channels = tuple(record.channel_id for record in self._records)
        return _Layout(layout.pack, itemgetter(*order), tuple(constants), channels, tuple(sizes), layout.size)
