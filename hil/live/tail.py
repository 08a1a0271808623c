"""The newest records of a topic, for those who look: one thread writes, any number read, and no one waits."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.log.records import CDR_HEADER, Schema

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
