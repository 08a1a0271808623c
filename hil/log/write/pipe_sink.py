"""Records from a loop into a pipe, for which the loop never waits.

Writes of up to ``PIPE_BUF`` bytes are all or nothing, so a full pipe costs whole slots and never the framing; a killed writer
leaves a torn frame at most at the very end. Reading end: `hil.log.write.pump`.

A frame is a head, and behind it one record, or the values of several. Head (little endian): u32 length of what follows, u16
number, i64 nominal time in ns, i64 how much later it happened in ns. The number is that of a channel, 0 for events, or one of
ours at the top: when session time 0 was, how many records the writer had to drop, what is in a block, and that the writer ended
in good order. A block has the values of one record of each of some channels, in a row and without gaps: a loop packs them by one
struct, and the reader makes records of them.
"""

from __future__ import annotations

import fcntl
import os
import select
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate, chain
from struct import Struct, error
from typing import Any, Final, Generic, TypeVar

from hil.log import encode_event
from hil.log.records import EVENTS_TOPIC, Channel
from hil.log.write import PayloadWriter, Record

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

_MOST: Final = 64  # the lengths of frames may come from the link

Made = TypeVar("Made")


class ByFrameLength(Generic[Made]):
    """Keeps what rows need whose frame has the same length.

    Args:
        records: of each, in order, how many numbers it has, and whether a frame follows them.
        make: makes it for a length in bytes, 0 for rows without a frame.

    Attributes:
        messages: records of a row.
        count: values of a row: the numbers of the first record, of the second, and so on; a frame stands behind its numbers.
        frame_at: which of them is the frame, None without one.

    Raises:
        ValueError: two of the records carry frames.
    """

    __slots__ = ("_made", "_make", "count", "frame_at", "messages")

    def __init__(self, records: Sequence[tuple[int, bool]], make: Callable[[int], Made]) -> None:
        frames = sum(frame for _, frame in records)
        if frames > 1:
            raise ValueError(f"records: {frames} carry frames, expected one at most")
        ends = [0, *accumulate(numbers + frame for numbers, frame in records)]
        self.messages, self.count = len(records), ends[-1]
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

    def refuse_others(self, values: Sequence[Any]) -> None:
        """Refuse what cannot be packed because it is no row.

        Raises:
            TypeError: not as many values as the records have.
        """
        if len(values) != self.count:
            raise TypeError(f"{len(values)} values, expected {self.count} in {self.messages} records") from None


PIPE_BYTES: Final = 1 << 20
TOGETHER_NS: Final = 8_000_000
MOST_TOGETHER: Final = 8
"""Slots whose records leave by one write: a loop that is killed loses these, and at most 8 ms."""


class PipeSink:
    """Writing end, in the loop's process: one ``write`` for some slots, never waiting, never raising.

    Args:
        fd: writing end of a pipe; it is made non-blocking and belongs to the sink from now on.
        channels: the session's table (``hil.log.topics.channels``), the same as in the reading process.
        period_ns: of a slot: as many leave together as begin in 8 ms, eight at most, and at once with an event. 0: each alone.
    """

    def __init__(self, fd: int, channels: Mapping[str, Channel], period_ns: int = 0) -> None:
        self.dropped = 0
        self.error: str | None = None
        self._fd = fd
        self._channels = channels
        self._records: list[bytes] = []
        self._messages: dict[int, int] = {}  # in a block, by its number
        self._rest = b""
        self._unreported = self._behind = 0
        self._together = min(MOST_TOGETHER, max(1, TOGETHER_NS // period_ns)) if period_ns else 1
        self._left = self._together  # slots until the next write
        os.set_blocking(fd, False)
        _widen(fd)

    def channel(self, topic: str) -> PayloadWriter | None:
        """See ``Sink``."""
        if topic == EVENTS_TOPIC:
            number = EVENTS_ID
        elif topic in self._channels:
            number = self._channels[topic].id
        else:
            return None
        head, records = HEAD.pack, self._records

        def put(t_ns: int, payload: bytes) -> None:
            records.append(head(len(payload), number, t_ns, self._behind) + payload)

        return put

    def records(self, topics: Sequence[str]) -> Record | None:
        """See ``PacksRecords``."""
        channels = [self._channels[topic] for topic in topics if topic in self._channels]
        if len(channels) < len(topics):
            return None
        if len(channels) == 1:
            return self._record(channels[0])
        codes = [(channel.schema.codes, channel.schema.raw) for channel in channels]

        def layout(length: int) -> tuple[Callable[..., bytes], int]:
            row = Struct(HEAD.format + "".join(own + (f"{length}s" if raw else "") for own, raw in codes))
            return row.pack, row.size - HEAD.size

        rows = ByFrameLength([(len(own), raw) for own, raw in codes], layout)
        at, number, records = rows.frame_at, self._declare(channels), self._records
        if number is None:
            return None

        def put(t_ns: int, values: Sequence[Any]) -> None:
            try:
                pack, size = rows.of(0 if at is None else len(values[at]))
                records.append(pack(size, number, t_ns, self._behind, *values))
            except (error, LookupError, TypeError):
                rows.refuse_others(values)
                raise

        return put

    def _record(self, channel: Channel) -> Record | None:
        put, pack = self.channel(channel.topic), channel.schema.pack
        return None if put is None else lambda t_ns, values: put(t_ns, pack(*values))

    def _declare(self, channels: Sequence[Channel]) -> int | None:
        """Say what is in a block, before its first; return its number, None where the pipe has no room for it."""
        number = FIRST_BLOCK_ID + len(self._messages)
        payload = b"".join(each.to_bytes(2, "little") for each in [number, *(channel.id for channel in channels)])
        if self._rest or not self._write(HEAD.pack(len(payload), BLOCK_ID, 0, 0) + payload):
            return None
        self._messages[number] = len(channels)
        return number

    def begin(self, wall_ns: int) -> None:
        """See ``Dated``."""
        self._records.append(HEAD.pack(COUNT.size, BEGIN_ID, 0, 0) + COUNT.pack(wall_ns))

    def behind(self, ns: int) -> None:
        """See ``Dated``."""
        self._behind = ns

    def event(self, t_ns: int, kind: str, message: str, *, slot: int = -1, severity: str = "info", **data: object) -> None:
        """See ``Sink``."""
        payload = encode_event(t_ns, kind, message, slot=slot, severity=severity, data=data)
        self._records.append(HEAD.pack(len(payload), EVENTS_ID, t_ns, self._behind) + payload)
        self._left = 0

    def commit(self) -> None:
        """See ``Sink``; hands the records of the last slots to the pipe, or counts them as dropped."""
        self._left -= 1
        if self._left <= 0:
            self._leave()

    def _leave(self) -> None:
        self._left, records = self._together, self._records
        if not records:
            return
        batch = b"".join(records)
        if len(batch) <= select.PIPE_BUF and not self._unreported and not self._rest:
            if not self._write(batch):
                self._drop(records)
        else:
            self._commit_in_parts(records)
        records.clear()

    def close(self, timeout_s: float = 0.2) -> None:
        """Commit, say that this is the end, and close the pipe; idempotent. Waits ``timeout_s`` at most for room."""
        if self._fd < 0:
            return
        self._leave()
        if self.error is None:
            poll = select.poll()
            poll.register(self._fd, select.POLLOUT)
            poll.poll(timeout_s * 1000)
            self._records.append(HEAD.pack(0, END_ID, 0, 0))
            self._leave()
        os.close(self._fd)
        self._fd = -1

    def _commit_in_parts(self, records: list[bytes]) -> None:
        if self._rest and not self._write_rest():
            self._drop(records)
            return
        if self._unreported:
            t_ns = HEAD.unpack_from(records[0])[2]
            report = HEAD.pack(COUNT.size, DROPPED_ID, t_ns, 0) + COUNT.pack(self._unreported)
            if not self._write(report):
                self._drop(records)
                return
            self._unreported = 0
        start = size = 0
        for stop, record in enumerate(chain(records, (None,))):
            if record is not None and size + len(record) <= select.PIPE_BUF:
                size += len(record)
                continue
            if stop > start and not self._write(b"".join(records[start:stop])):
                self._drop(records[start:])
                return
            start, size = stop, len(record) if record is not None else 0
            if self._rest and record is not None:
                self._drop(records[start:])
                return

    def _write(self, batch: bytes) -> bool:
        if self.error is not None:
            return False
        try:
            done = os.write(self._fd, batch)
        except BlockingIOError:
            return False
        except OSError as error:
            self.error = f"log pipe: {error.strerror or error}"
            return False
        if done < len(batch):  # only a record of more than PIPE_BUF bytes can be cut
            self._rest = batch[done:]
        return True

    def _write_rest(self) -> bool:
        rest, self._rest = self._rest, b""
        if not self._write(rest):
            self._rest = rest
        return not self._rest

    def _drop(self, records: Sequence[bytes]) -> None:
        count = sum(self._messages.get(HEAD.unpack_from(record)[1], 1) for record in records)
        self.dropped += count
        self._unreported += count


def _widen(fd: int) -> None:
    """Give a pipe 1 MiB, or as much as the system allows; a socket or a file does as well."""
    for size in (PIPE_BYTES, PIPE_BYTES >> 2):
        try:
            fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, size)
            return
        except OSError:
            continue
