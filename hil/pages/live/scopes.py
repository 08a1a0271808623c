"""What the scopes show of a time window: the smallest and the largest value of each column, so that no spike is lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.log.records import CDR_HEADER, Schema
from hil.log.topics import panels

KEPT: Final = 16_000_000
"""Bytes that are kept of a topic, at least; twice as many at most."""

_SKIP: Final = len(CDR_HEADER)
Records = NDArray[np.void]


class Tail:
    """Records of a topic of numbers, as they come; the oldest are forgotten.

    A reader keeps the buffer with which it began: the writer never changes a byte that it has handed out.

    Args:
        schema: of the topic; it has no raw frames.
        most: bytes that are kept, at least.
    """

    def __init__(self, schema: Schema, most: int = KEPT) -> None:
        self._dtype, self._size = schema.dtype, schema.dtype.itemsize
        self._room = max(most // self._size, 2) * self._size
        self._state = bytearray(2 * self._room), 0

    def put(self, t_ns: int, payload: bytes) -> None:
        """Take a record."""
        buffer, end = self._state
        if end == len(buffer):
            fresh = bytearray(len(buffer))
            fresh[: self._room] = buffer[end - self._room :]
            buffer, end = fresh, self._room
        after = end + self._size
        buffer[end:after] = payload[_SKIP : _SKIP + self._size]
        self._state = buffer, after

    def records(self) -> Records:
        """Return the newest records, a structured array; it costs no copy."""
        buffer, end = self._state
        found: Any = np.frombuffer(buffer, self._dtype, end // self._size)
        return found  # type: ignore[no-any-return]


Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace:
    """One curve of a scope.

    Args:
        panel: title of the scope.
        topic, field: where its values stand.
        unit: of its values.
    """

    panel: str
    topic: str
    field: str
    unit: str


def traces_of(schemas: Mapping[str, Schema]) -> tuple[Trace, ...]:
    """Return the curves of a session's scopes, from its registry of topics, scope by scope."""
    units = {(topic, f.name): f.unit for topic, schema in schemas.items() for f in schema.fields}
    return tuple(
        Trace(panel=panel, topic=topic, field=curve.field, unit=units[topic, curve.field])
        for panel, curves in panels(schemas).items()
        for topic, curve in curves
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Slots [first, end) in columns of so many slots.

    Args:
        first: slot of the first column's beginning, a multiple of `slots`, so that columns do not flicker as time goes on.
        columns: their number.
        slots: of one column.
    """

    first: int
    columns: int
    slots: int

    @classmethod
    def over(cls, first: int, end: int, most: int) -> Window:
        """Return the window over some slots in as many columns as are asked for, or fewer.

        >>> Window.over(7, 27, 10)
        Window(first=6, columns=11, slots=2)
        """
        slots = max(-(-(end - first) // max(most, 1)), 1)
        begin = first - first % slots
        return cls(first=begin, columns=max(-(-(end - begin) // slots), 1), slots=slots)


def thinned(records: Records, field: str, window: Window) -> tuple[Array, Array]:
    """Return the smallest and the largest value of a field in every column, (columns,) each; NaN where there is none.

    Args:
        records: of a topic, in the order of slots, with the field ``tick``.
        field: of numbers.
        window: the columns.
    """
    low, high = np.full(window.columns, np.nan), np.full(window.columns, np.nan)
    edges = np.arange(window.columns + 1, dtype=np.int64) * window.slots + window.first
    places = np.searchsorted(records["tick"], edges)
    there = np.flatnonzero(places[1:] > places[:-1])
    if len(there):
        values = np.asarray(records[field][places[0] : places[-1]], dtype=float)
        starts = places[:-1][there] - places[0]
        low[there], high[there] = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    return low, high


def picture(records: Mapping[str, Records], traces: Sequence[Trace], window: Window) -> bytes:
    """Return the lows and highs of every trace, one behind the other, as float32 of little endian."""
    none: Any = np.full(window.columns, np.nan)
    rows: list[Array] = []
    for trace in traces:
        found = records.get(trace.topic)
        rows += [none, none] if found is None or not len(found) else thinned(found, trace.field, window)
    return np.array(rows, dtype="<f4").tobytes() if rows else b""
