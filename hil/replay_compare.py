"""Records of a log beside those of a second run of it, batch by batch: where do they first differ?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from hil.log.read.arrays import StructuredArray, assemble
from hil.log.records import Channel
from hil.log.run import Run
from hil.log.write.sinks import MemorySink

BATCH: Final = 2048
"""Slots whose records are compared together."""

_NONE: Final[StructuredArray] = np.empty(0, [("tick", np.int64)])

Difference = tuple[int, str]


class Comparison:
    """What a log holds, and what runs again now: the first difference of every topic.

    Args:
        run: the log.
        channels: the session's table.
        topics: that are compared.
        slots: records of later slots are left out.

    Attributes:
        sink: takes the records of now.
    """

    def __init__(self, run: Run, channels: Mapping[str, Channel], topics: list[str], slots: int) -> None:
        self.sink = MemorySink(channels, topics)
        self._channels = channels
        self._topics = {topic: _Topic(topic, run, slots) for topic in topics}

    def compare(self) -> None:
        """Compare what has come since the last time."""
        for topic, own in self._topics.items():
            times, payloads = self.sink.times[topic], self.sink.payloads[topic]
            own.take(assemble(self._channels[topic].schema, payloads, times=times))
            times.clear()
            payloads.clear()

    def differences(self, slots: int) -> list[Difference]:
        """Return the first difference of every topic in slots below a number, after the last comparison.

        Args:
            slots: later ones are left out.
        """
        found = [own.finish(slots) for own in self._topics.values()]
        return [difference for difference in found if difference is not None and difference[0] < slots]


class _Topic:
    def __init__(self, topic: str, run: Run, slots: int) -> None:
        self._topic, self._slots = topic, slots
        self._recorded = _Reader(in_time(piece) for piece in run.pieces(topic, BATCH))
        self._found: Difference | None = None

    def take(self, now: StructuredArray) -> None:
        if self._found is None:
            now = now[now["tick"] < self._slots]
            self._found = _difference(self._topic, self._recorded.next(len(now), self._slots), now)

    def finish(self, slots: int) -> Difference | None:
        if self._found is None:
            left = self._recorded.next(1, slots)
            self._found = _difference(self._topic, left, left[:0])
        return self._found


class _Reader:
    """The records of pieces, as many at a time as are asked for."""

    def __init__(self, pieces: Iterator[StructuredArray]) -> None:
        self._pieces = pieces
        self._rest = _NONE

    def next(self, n: int, slots: int) -> StructuredArray:
        """Return the next n records of slots below a number, fewer at the end."""
        found: list[StructuredArray] = []
        while n:
            if not len(self._rest):
                more = next(self._pieces, None)
                if more is None:
                    break
                self._rest = more[more["tick"] < slots]
                continue
            found.append(self._rest[:n])
            self._rest = self._rest[n:]
            n -= len(found[-1])
        return np.concatenate(found) if found else _NONE


def in_time(records: StructuredArray) -> StructuredArray:
    """Return the records without the frames that came too late."""
    return records[records["late"] == 0] if "late" in (records.dtype.names or ()) else records


def _difference(topic: str, recorded: StructuredArray, now: StructuredArray) -> Difference | None:
    """Return the first slot in which two series of records differ, and how."""
    n = min(len(recorded), len(now))
    a, b = recorded[:n], now[:n]
    names = [name for name in now.dtype.names or () if name != "tick"] if n else []
    differs = {name: (a[name] != b[name]) & ((a[name] == a[name]) | (b[name] == b[name])) for name in ["tick", *names]}
    where = np.flatnonzero(np.any([*differs.values()], axis=0))
    if not where.size and len(recorded) == len(now):
        return None
    i = int(where[0]) if where.size else n
    if i >= n or differs["tick"][i]:
        missing = i < len(now) and (i >= len(recorded) or recorded["tick"][i] > now["tick"][i])
        slot = int((now if missing else recorded)["tick"][i])
        return slot, f"{topic}: a record of slot {slot} is {'missing' if missing else 'there that should not be'}"
    name, slot = next(name for name in names if differs[name][i]), int(now["tick"][i])
    return slot, f"{topic} of slot {slot}: {name} = {a[name][i]} recorded, {b[name][i]} now"
