"""Records from the pipe of a loop into a log, in another process. Writing end: `hil.log.write.pipe_sink`.

Who waits at the pipe is woken by every write, and waking takes the loop as long as all else that it does for the log. So the
pump looks by itself. Before a session it is rehearsed (`rehearse`): a log that goes nowhere is written, so that memory for a
burst is taken before the run, and not during it.
"""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from struct import Struct, iter_unpack
from typing import Final

from hil.errors import HilError
from hil.log.records import CDR_HEADER, EVENTS_TOPIC, Channel
from hil.log.write import Dated, PayloadWriter, Sink, both, record_to
from hil.log.write import pipe_sink as pipe
from hil.log.write.mcap_sink import REAL_FLUSH_BYTES, McapSink
from hil.log.write.pipe_sink import PipeSink
from hil.log.write.provenance import Provenance

_LENGTH: Final = Struct("<I")
_MAX_PAYLOAD: Final = 1 << 24
_READ_BYTES: Final = 1 << 13
"""Little, so that what has waited comes in portions: memory does not grow by the longest wait so far."""

_LOOK_MS: Final = 5
"""Between two looks at an empty pipe: at 10 kHz a pipe of 64 KiB holds three times that."""


@dataclass(slots=True, kw_only=True)
class PumpReport:
    """What came through the pipe.

    Args:
        records: records handed to the sink.
        dropped: records that the writer could not write, as far as it could still say so.
        malformed: frames of no known channel, or of a wrong length.
        torn_bytes: bytes of the last, incomplete frame of a writer that was killed.
        complete: whether the writer ended in good order.
        last_ns: session time of the last record.
    """

    records: int = 0
    dropped: int = 0
    malformed: int = 0
    torn_bytes: int = 0
    complete: bool = False
    last_ns: int = field(default=0, compare=False)


def pump(
    fd: int,
    sink: Sink,
    channels: Mapping[str, Channel],
    *,
    taps: Mapping[str, PayloadWriter] | None = None,
    stop: Callable[[], bool] = lambda: False,
    report: PumpReport | None = None,
) -> PumpReport:
    """Carry records from the pipe to a sink until the writer is gone, however it went.

    Args:
        fd: reading end of the pipe; stays open.
        sink: gets the records; committed after every read and every look.
        channels: the session's table.
        taps: topic to a function that also gets time and payload of that topic's records, for a live view; none may raise, see
            `hil.log.write.harmless`.
        stop: asked whenever the pipe is empty; true ends the pump though a process still holds the writing end.
        report: filled in as records come, for who watches; a new one by default.

    Returns:
        What came, and what was lost.
    """
    report = report or PumpReport()
    takers = _Takers(sink, channels, taps or {})
    waiting, nothing = select.poll(), select.poll()
    waiting.register(fd, select.POLLIN)
    data, room = b"", memoryview(bytearray(_READ_BYTES))  # kept: one for every read would tear the heap
    while True:  # until the writer is gone
        count = -1
        if waiting.poll(0):
            count = os.readv(fd, [room])
            if not count:
                break
            torn = _take(data + room[:count], takers, sink, report)
            if torn is None:
                break
            data = torn
        sink.commit()
        if count < 0 and stop():
            break
        if count < _READ_BYTES:
            nothing.poll(_LOOK_MS)
    report.torn_bytes = len(data)
    sink.commit()
    return report


_Taker = Callable[[int, bytes], int]
"""Takes time and payload of a frame; returns how many records were in it, 0 where it is of a wrong length."""


class _Takers:
    """What takes a frame, by its number: one for every channel, and for every block that the writer has declared."""

    def __init__(self, sink: Sink, channels: Mapping[str, Channel], taps: Mapping[str, PayloadWriter]) -> None:
        self._channels = {channel.id: channel for channel in channels.values()}
        self._puts: dict[int, PayloadWriter] = {}
        for topic, number in [(EVENTS_TOPIC, pipe.EVENTS_ID), *((channel.topic, channel.id) for channel in channels.values())]:
            put = sink.channel(topic) or _ignore
            self._puts[number] = both(taps[topic], put) if topic in taps else put
        self._taken: dict[int, _Taker] = {number: self._single(number) for number in self._puts}
        self.of = self._taken.get

    def _single(self, number: int) -> _Taker:
        put, channel = self._puts[number], self._channels.get(number)
        least = 0 if channel is None else channel.schema.data_offset if channel.schema.raw else 4 + channel.schema.dtype.itemsize
        fixed = channel is not None and not channel.schema.raw

        def take(t_ns: int, payload: bytes) -> int:
            if len(payload) < least or (fixed and len(payload) > least):
                return 0
            put(t_ns, payload)
            return 1

        return take

    def declare(self, payload: bytes) -> bool:
        """Learn what a block has; return False where that is nothing that could be in one."""
        if len(payload) < 4 or len(payload) % 2:
            return False
        number, *ids = (each for (each,) in iter_unpack("<H", payload))
        if not pipe.FIRST_BLOCK_ID <= number < pipe.BLOCK_ID or any(each not in self._channels for each in ids):
            return False
        schemas = [self._channels[each].schema for each in ids]
        if sum(schema.raw for schema in schemas) > 1:
            return False
        parts = [(schema.dtype.itemsize, schema.raw, self._puts[each]) for schema, each in zip(schemas, ids)]
        numbers, framed = sum(width for width, _, _ in parts), any(schema.raw for schema in schemas)

        def take(t_ns: int, data: bytes) -> int:
            length, at = len(data) - numbers, 0
            if length < 0 or (length and not framed):
                return 0
            for width, raw, put in parts:
                payload = CDR_HEADER + data[at : at + width]
                at += width
                if raw:
                    payload += bytes(-width % 4) + _LENGTH.pack(length) + data[at : at + length]
                    at += length
                put(t_ns, payload)
            return len(parts)

        self._taken[number] = take
        return True


def _take(data: bytes, takers: _Takers, sink: Sink, report: PumpReport) -> bytes | None:
    """Hand over every whole frame of ``data`` and return the rest, or None where the framing is lost."""
    at, end, head = 0, len(data), pipe.HEAD.unpack_from
    dated = sink if isinstance(sink, Dated) else None
    before = None
    while end - at >= pipe.HEAD.size:
        size, number, t_ns, behind = head(data, at)
        after = at + pipe.HEAD.size + size
        if after > end:
            if size > _MAX_PAYLOAD:  # not ours; nothing behind it can be trusted
                report.malformed += 1
                return None
            break
        payload = data[at + pipe.HEAD.size : after]
        at = after
        taker = takers.of(number)
        if taker is not None:
            if behind != before and dated is not None:
                dated.behind(behind)
                before = behind
            taken = taker(t_ns, payload)
            report.records += taken
            if taken:
                report.last_ns = t_ns
            else:
                report.malformed += 1
        elif number == pipe.DROPPED_ID and size == pipe.COUNT.size:
            lost = pipe.COUNT.unpack(payload)[0]
            report.dropped += lost
            sink.event(t_ns, "log-dropped", f"{lost} records were dropped: the log's pipe was full",
                       severity="warning", records=lost)
        elif number == pipe.END_ID and not size:
            report.complete = True
        elif number == pipe.BEGIN_ID and size == pipe.COUNT.size:
            if dated is not None:
                dated.begin(pipe.COUNT.unpack(payload)[0])
        elif number != pipe.BLOCK_ID or not takers.declare(payload):
            report.malformed += 1
    if dated is not None:
        dated.behind(0)  # of what this process says itself
    return data[at:]


def _ignore(t_ns: int, payload: bytes) -> None:
    """Take a record that is not kept."""


FRAME = bytes(64)


def rehearse(channels: Mapping[str, Channel]) -> None:
    """Carry the longest burst through a pipe to a log, as `pump` does it, in this thread.

    Where it cannot (no descriptor is left), the session's memory grows by a burst, and nothing else is lost.

    Args:
        channels: the session's table.
    """
    with suppress(OSError, HilError), ExitStack() as stack:
        read_fd, write_fd = os.pipe()
        stack.callback(os.close, read_fd)
        _burst(write_fd, channels)
        nothing = Provenance(
            experiment="", experiment_text="", resolved={}, seed=0, clock="real", link="", versions={}, commit=""
        )  # fmt: skip
        with McapSink(os.devnull, channels, nothing, now=lambda: 0.0) as sink:
            pump(read_fd, sink, channels)


def _burst(fd: int, channels: Mapping[str, Channel]) -> None:
    source, length = PipeSink(fd, channels), 0
    try:
        rows = []
        for channel in channels.values():
            schema = channel.schema
            values = [0] * len(schema.codes) + [FRAME] * schema.raw
            rows.append((record_to(source, channel), values, schema.dtype.itemsize + len(FRAME) * schema.raw))
        k = 0
        while length < 2 * REAL_FLUSH_BYTES:
            for put, values, size in rows:
                if put is not None:
                    put(k, values)
                length += size
            source.commit()
            k += 1
    finally:
        source.close()
