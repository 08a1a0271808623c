"""Records from a loop to another process, through a pipe for which the loop never waits.

A stream of frames, each a little-endian head (u32 payload length, u16 channel number, i64 nominal time in ns, i64 how much
later it happened) and the payload. Channel 0 carries events; three numbers at the top are ours: when session time 0 was, how
many records the writer had to drop, and that it ended in good order. Writes of up to ``PIPE_BUF`` bytes are all or nothing, so
a full pipe costs whole ticks and never the framing; a killed writer leaves a torn frame at most at the very end.
"""

from __future__ import annotations

import fcntl
import os
import select
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from struct import Struct
from typing import Any, Final

from hil.log.events import encode_event
from hil.log.records import EVENTS_TOPIC, Channel
from hil.log.write.pipe_block import HEAD, PipeBlock, frames_in
from hil.log.write.sinks import Dated, PayloadWriter, Record, Sink

PIPE_BYTES: Final = 1 << 20
_EVENTS_ID: Final = 0
_DROPPED_ID: Final = 0xFFFF
_END_ID: Final = 0xFFFE
_BEGIN_ID: Final = 0xFFFD
_COUNT: Final = Struct("<Q")
_MAX_PAYLOAD: Final = 1 << 24
_READ_BYTES: Final = 1 << 13
"""Little, so that what has waited comes in portions: memory does not grow by the longest wait so far."""


class PipeSink:
    """Writing end, in the loop's process: one ``write`` per tick, never waiting, never raising.

    Args:
        fd: writing end of a pipe; it is made non-blocking and belongs to the sink from now on.
        channels: the session's table (``hil.log.topics.channels``), the same as in the reading process.
    """

    def __init__(self, fd: int, channels: Mapping[str, Channel]) -> None:
        self.dropped = 0
        self.error: str | None = None
        self._fd = fd
        self._channels = channels
        self._records: list[bytes] = []
        self._rest = b""
        self._unreported = self._behind = 0
        os.set_blocking(fd, False)
        widen(fd)

    def channel(self, topic: str) -> PayloadWriter | None:
        """See ``Sink``."""
        if topic == EVENTS_TOPIC:
            number = _EVENTS_ID
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
        pack, records = PipeBlock(channels).pack, self._records

        def put(t_ns: int, values: Sequence[Any]) -> None:
            records.append(pack(t_ns, self._behind, values))

        return put

    def begin(self, wall_ns: int) -> None:
        """See ``Dated``."""
        self._records.append(HEAD.pack(_COUNT.size, _BEGIN_ID, 0, 0) + _COUNT.pack(wall_ns))

    def behind(self, ns: int) -> None:
        """See ``Dated``."""
        self._behind = ns

    def event(
        self, t_ns: int, kind: str, message: str, *, tick: int = -1, severity: str = "info", **data: object
    ) -> None:
        """See ``Sink``."""
        payload = encode_event(t_ns, kind, message, tick=tick, severity=severity, data=data)
        self._records.append(HEAD.pack(len(payload), _EVENTS_ID, t_ns, self._behind) + payload)

    def commit(self) -> None:
        """See ``Sink``; hands the tick's records to the pipe, or counts them as dropped."""
        records = self._records
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
        self.commit()
        if self.error is None:
            poll = select.poll()
            poll.register(self._fd, select.POLLOUT)
            poll.poll(timeout_s * 1000)
            self._records.append(HEAD.pack(0, _END_ID, 0, 0))
            self.commit()
        os.close(self._fd)
        self._fd = -1

    def _commit_in_parts(self, records: list[bytes]) -> None:
        if self._rest and not self._write_rest():
            self._drop(records)
            return
        if self._unreported:
            t_ns = HEAD.unpack_from(records[0])[2]
            report = HEAD.pack(_COUNT.size, _DROPPED_ID, t_ns, 0) + _COUNT.pack(self._unreported)
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
        count = sum(map(frames_in, records))
        self.dropped += count
        self._unreported += count


@dataclass(slots=True, kw_only=True)
class PumpReport:
    """What came through the pipe.

    Args:
        records: records handed to the sink.
        dropped: records that the writer could not write, as far as it could still say so.
        malformed: frames of no known channel, or of a wrong length.
        torn_bytes: bytes of the last, incomplete frame of a writer that was killed.
        complete: whether the writer ended in good order.
        faults: taps that raised and were taken off.
        last_ns: session time of the last record.
    """

    records: int = 0
    dropped: int = 0
    malformed: int = 0
    torn_bytes: int = 0
    complete: bool = False
    faults: list[str] = field(default_factory=list)
    last_ns: int = field(default=0, compare=False)


def pump(
    fd: int,
    sink: Sink,
    channels: Mapping[str, Channel],
    *,
    taps: Mapping[str, PayloadWriter] | None = None,
    stop: Callable[[], bool] = lambda: False,
    report: PumpReport | None = None,
    poll_s: float = 0.02,
) -> PumpReport:
    """Carry records from the pipe to a sink until the writer is gone, however it went.

    Args:
        fd: reading end of the pipe; stays open.
        sink: gets the records; committed after every read and at least every ``poll_s``.
        channels: the session's table.
        taps: topic to a function that also gets time and payload of that topic's records, for a live view. One that raises is
            taken off and reported.
        stop: asked whenever the pipe is empty; true ends the pump though a process still holds the writing end.
        report: filled in as records come, for who watches; a new one by default.
        poll_s: longest wait in s.

    Returns:
        What came, and what was lost.
    """
    report = report or PumpReport()
    takers = _takers(sink, channels, taps or {}, report)
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    data, room = b"", memoryview(bytearray(_READ_BYTES))  # kept: one for every read would tear the heap
    while True:  # until the writer is gone
        if poll.poll(poll_s * 1000):
            count = os.readv(fd, [room])
            if not count:
                break
            torn = _take(data + room[:count], takers, sink, report)
            sink.commit()
            if torn is None:
                break
            data = torn
        else:
            sink.commit()
            if stop():
                break
    report.torn_bytes = len(data)
    sink.commit()
    return report


def widen(fd: int) -> int:
    """Give a pipe 1 MiB, or as much as the system allows; returns its size in bytes."""
    for size in (PIPE_BYTES, PIPE_BYTES >> 2):
        try:
            return fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, size)
        except OSError:
            continue
    try:
        return fcntl.fcntl(fd, fcntl.F_GETPIPE_SZ)
    except OSError:
        return 0  # no pipe: a socket or a file does as well


_Taker = tuple[PayloadWriter, int | None, int]


def _takers(
    sink: Sink, channels: Mapping[str, Channel], taps: Mapping[str, PayloadWriter], report: PumpReport
) -> dict[int, _Taker]:
    takers: dict[int, _Taker] = {}
    for topic, number in chain([(EVENTS_TOPIC, _EVENTS_ID)], ((c.topic, c.id) for c in channels.values())):
        put = sink.channel(topic) or _ignore
        if topic in taps:
            put = _tapped(topic, put, taps[topic], report)
        if number == _EVENTS_ID:
            takers[number] = (put, None, 0)
        else:
            schema = channels[topic].schema
            takers[number] = (put, None, schema.data_offset) if schema.raw else (put, 4 + schema.dtype.itemsize, 0)
    return takers


def _take(data: bytes, takers: Mapping[int, _Taker], sink: Sink, report: PumpReport) -> bytes | None:
    """Hand over every whole frame of ``data`` and return the rest, or None where the framing is lost."""
    at, end, head, records = 0, len(data), HEAD.unpack_from, 0
    dated = sink if isinstance(sink, Dated) else None
    before = None
    while end - at >= HEAD.size:
        size, number, t_ns, behind = head(data, at)
        after = at + HEAD.size + size
        if after > end:
            if size > _MAX_PAYLOAD:  # not ours; nothing behind it can be trusted
                report.malformed += 1
                report.records += records
                return None
            break
        payload = data[at + HEAD.size : after]
        at = after
        taker = takers.get(number)
        if taker is not None and (size == taker[1] if taker[1] is not None else size >= taker[2]):
            if behind != before and dated is not None:
                dated.behind(behind)
                before = behind
            taker[0](t_ns, payload)
            report.last_ns = t_ns
            records += 1
        elif number == _DROPPED_ID and size == _COUNT.size:
            lost = _COUNT.unpack(payload)[0]
            report.dropped += lost
            sink.event(t_ns, "log-dropped", f"{lost} records were dropped: the log's pipe was full",
                       severity="warning", records=lost)
        elif number == _END_ID and not size:
            report.complete = True
        elif number == _BEGIN_ID and size == _COUNT.size:
            if dated is not None:
                dated.begin(_COUNT.unpack(payload)[0])
        else:
            report.malformed += 1
    report.records += records
    if dated is not None:
        dated.behind(0)  # of what this process says itself
    return data[at:]


def _ignore(t_ns: int, payload: bytes) -> None:
    """Take a record that is not kept."""


def _tapped(topic: str, put: PayloadWriter, tap: PayloadWriter, report: PumpReport) -> PayloadWriter:
    on = True

    def put_and_tap(t_ns: int, payload: bytes) -> None:
        nonlocal on
        put(t_ns, payload)
        if on:
            try:
                tap(t_ns, payload)
            except Exception as error:  # a live view must not cost the log
                on = False
                report.faults.append(f"tap {topic}: {type(error).__name__}: {error}")

    return put_and_tap
