"""Records from a loop into a pipe, for which the loop never waits.

Writes of up to ``PIPE_BUF`` bytes are all or nothing, so a full pipe costs whole slots and never the framing; a killed writer
leaves a torn frame at most at the very end. Reading end: `hil.log.write.pump`.
"""

from __future__ import annotations

import fcntl
import os
import select
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any, Final

from hil.log.events import encode_event
from hil.log.records import EVENTS_TOPIC, Channel
from hil.log.write.pipe_block import BEGIN_ID, BLOCK_ID, COUNT, DROPPED_ID, END_ID, EVENTS_ID, FIRST_BLOCK_ID, HEAD, PipeBlock
from hil.log.write.sinks import PayloadWriter, Record

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
        block = PipeBlock(FIRST_BLOCK_ID + len(self._messages), channels)
        if not self._declare(block.number, channels):
            return None
        self._messages[block.number] = block.messages
        records = self._records

        def put(t_ns: int, values: Sequence[Any]) -> None:
            records.append(block.pack(t_ns, self._behind, values))

        return put

    def _record(self, channel: Channel) -> Record | None:
        put, pack = self.channel(channel.topic), channel.schema.pack
        return None if put is None else lambda t_ns, values: put(t_ns, pack(*values))

    def _declare(self, number: int, channels: Sequence[Channel]) -> bool:
        """Say what is in a block, before its first; return False where the pipe has no room for it."""
        numbers = [number, *(channel.id for channel in channels)]
        payload = b"".join(each.to_bytes(2, "little") for each in numbers)
        return not self._rest and self._write(HEAD.pack(len(payload), BLOCK_ID, 0, 0) + payload)

    def begin(self, wall_ns: int) -> None:
        """See ``Dated``."""
        self._records.append(HEAD.pack(COUNT.size, BEGIN_ID, 0, 0) + COUNT.pack(wall_ns))

    def behind(self, ns: int) -> None:
        """See ``Dated``."""
        self._behind = ns

    def event(
        self, t_ns: int, kind: str, message: str, *, slot: int = -1, severity: str = "info", **data: object
    ) -> None:
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
