"""The replay of a log: verify it, run another controller on it, put it on a link.

Here the first difference between the records of a log and those of a second run is found, batch by batch.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from hil.log.records import Channel
from hil.log.run import Run, StructuredArray, assemble
from hil.log.write import MemorySink
from transport.packets import decode

BATCH: Final = 2048
"""Slots whose records are compared together."""

NEAR: Final = 1e-9
"""Largest difference that rounding on another machine makes, as a share of the largest value of a signal so far."""

WIRE: Final = 2.0**-22
"""The same for a value in a frame, which is in single precision: two units in the last place."""

_NONE: Final[StructuredArray] = np.empty(0, [("slot", np.int64)])

Difference = tuple[int, str]


class Comparison:
    """The first difference, in every topic, between a log and a second run.

    Args:
        run: the log.
        channels: the session's table.
        topics: that are compared.
        slots: number of slots that are compared.

    Attributes:
        sink: takes the records of the second run.
    """

    def __init__(self, run: Run, channels: Mapping[str, Channel], topics: list[str], slots: int) -> None:
        self.sink = MemorySink(channels, topics)
        self._channels = channels
        self._topics = {topic: _Topic(topic, run, slots) for topic in topics}

    def compare(self) -> None:
        """Compare the records that have come since the last call."""
        for topic, own in self._topics.items():
            times, payloads = self.sink.times[topic], self.sink.payloads[topic]
            own.take(assemble(self._channels[topic].schema, payloads, times=times))
            times.clear()
            payloads.clear()

    def differences(self, slots: int, *, far: bool = False) -> list[Difference]:
        """Return the first difference of every topic in slots below a number, after the last comparison.

        Args:
            slots: number of slots that count.
            far: only differences beyond `NEAR`.
        """
        ended = [own.finish(slots) for own in self._topics.values()]
        found = [own.far if far else own.exact for own in ended]
        return [difference for difference in found if difference is not None and difference[0] < slots]


class _Topic:
    def __init__(self, topic: str, run: Run, slots: int) -> None:
        self._topic, self._slots = topic, slots
        self._recorded = _Reader(in_time(piece) for piece in run.pieces(topic, BATCH))
        self._largest: dict[str, float] = {}
        self._ended = False
        self.exact: Difference | None = None
        self.far: Difference | None = None

    def take(self, now: StructuredArray) -> None:
        if self.far is None:
            now = now[now["slot"] < self._slots]
            self._compare(self._recorded.next(len(now), self._slots), now)

    def finish(self, slots: int) -> _Topic:
        if self.far is None and not self._ended:
            left = self._recorded.next(1, slots)
            self._compare(left, left[:0])
        self._ended = True
        return self

    def _compare(self, recorded: StructuredArray, now: StructuredArray) -> None:
        found = _difference(self._topic, recorded, now)
        self.exact = self.exact or found
        for name in now.dtype.names or ():
            if recorded.dtype.names and now[name].dtype.kind == "f" and len(recorded):
                sizes = np.abs(recorded[name][np.isfinite(recorded[name])])
                self._largest[name] = max(self._largest.get(name, 0.0), float(sizes.max(initial=0.0)))
        if found is not None:
            self.far = _difference(self._topic, recorded, now, self._largest)


class _Reader:
    """Reads records that come in pieces, any number at a time."""

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
                self._rest = more[more["slot"] < slots]
                continue
            found.append(self._rest[:n])
            self._rest = self._rest[n:]
            n -= len(found[-1])
        return np.concatenate(found) if found else _NONE


def in_time(records: StructuredArray) -> StructuredArray:
    """Return the records without the frames that came too late."""
    return records[records["late"] == 0] if "late" in (records.dtype.names or ()) else records


def near_frames(recorded: bytes, now: bytes) -> bool:
    """Return whether two frames are equal up to the last bits of their numbers."""
    a, b = decode(recorded), decode(now)
    return type(a) is type(b) and near_values(a, b)


def near_values(a: Any, b: Any) -> bool:
    """Return whether two values of a frame are equal up to the last bits of their numbers."""
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(near_values(x, y) for x, y in zip(a, b))
    if isinstance(a, float) and isinstance(b, float):
        return a == b or abs(a - b) <= WIRE * max(abs(a), abs(b)) or (a != a and b != b)
    return bool(a == b)


def _difference(
    topic: str, recorded: StructuredArray, now: StructuredArray, largest: Mapping[str, float] | None = None
) -> Difference | None:  # fmt: skip
    """Return the first slot in which two series of records differ, and how.

    Args:
        topic: of the records.
        recorded, now: the series.
        largest: largest value of every signal so far, for which values within `NEAR` are equal; None: equal means the same bits.
    """
    n = min(len(recorded), len(now))
    a, b = recorded[:n], now[:n]
    names = [name for name in now.dtype.names or () if name != "slot"] if n else []
    differs = {name: (a[name] != b[name]) & ((a[name] == a[name]) | (b[name] == b[name])) for name in ["slot", *names]}
    for name in names if largest is None else ():
        if a[name].dtype.kind == "f":  # zeros of both signs are equal, and other bits
            differs[name] |= (a[name] == b[name]) & (np.signbit(a[name]) != np.signbit(b[name]))
    if largest is not None:
        for name in names:
            for i in np.flatnonzero(differs[name]).tolist():
                x, y = a[name][i], b[name][i]
                if isinstance(x, bytes):
                    differs[name][i] = not near_frames(x, y)
                elif a[name].dtype.kind == "f":
                    differs[name][i] = not abs(float(x) - float(y)) <= NEAR * largest[name]
    where = np.flatnonzero(np.any([*differs.values()], axis=0))
    if not where.size and len(recorded) == len(now):
        return None
    i = int(where[0]) if where.size else n
    if i >= n or differs["slot"][i]:
        missing = i < len(now) and (i >= len(recorded) or recorded["slot"][i] > now["slot"][i])
        slot = int((now if missing else recorded)["slot"][i])
        return slot, f"{topic}: a record of slot {slot} is {'missing' if missing else 'there that should not be'}"
    name, slot = next(name for name in names if differs[name][i]), int(now["slot"][i])
    return slot, f"{topic} of slot {slot}: {name} = {a[name][i]} recorded, {b[name][i]} now"
