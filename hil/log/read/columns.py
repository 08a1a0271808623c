"""The records of a topic as columns, gathered chunk by chunk: what is kept is numbers, not a Python object for each record.

The columns of a long log grow in files without a name (`hil.log.append_column`), so that memory does not grow with the log.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Final

import numpy as np

from hil.log.append_column import ROWS, AppendColumn, pieces, release
from hil.log.read.mcap_walk import MESSAGE_PAYLOAD_AT, MESSAGE_TIME_AT
from hil.log.records import TIME_FIELD, Schema
from hil.log.run import StructuredArray, assemble, run_dtype

TOGETHER: Final = 4096
"""Messages that are turned into numbers together."""


class Columns:
    """One topic's records, in the order of the log.

    Args:
        schema: of the topic.
        folder: where those of a long log are kept.
        start_ns: log time of session time 0, ns.
    """

    def __init__(self, schema: Schema, folder: str | os.PathLike[str] | None = None, start_ns: int = 0) -> None:
        self.schema = schema
        self._start_ns = start_ns
        self._messages: list[bytes] = []
        self._dtype = run_dtype(schema)
        self._raw = schema.fields[-1].name if schema.raw else None
        self._numbers = AppendColumn([(name, self._dtype[name]) for name in self._dtype.names or () if name != self._raw], folder)
        self._lengths, self._bytes = AppendColumn(np.int64, folder), AppendColumn(np.uint8, folder)

    def add(self, messages: list[bytes]) -> None:
        """Take messages, framing included.

        Raises:
            HilError: if one is not as the schema says.
        """
        self._messages += messages
        if len(self._messages) >= TOGETHER:
            self.finish()

    def finish(self) -> None:
        """Turn what was taken into numbers.

        Raises:
            HilError: if a message is not as the schema says.
        """
        if not self._messages:
            return
        found = assemble(self.schema, self._messages, payload_at=MESSAGE_PAYLOAD_AT, time_at=MESSAGE_TIME_AT)
        self._messages = []
        found[TIME_FIELD] -= self._start_ns
        if self._raw is None:
            self._numbers.extend(found)
            return
        data = found[self._raw].tolist()
        self._numbers.extend(found[[*(self._numbers.dtype.names or ())]].astype(self._numbers.dtype))
        self._lengths.extend(np.array([len(each) for each in data], np.int64))
        self._bytes.extend(np.frombuffer(b"".join(data), np.uint8))

    def numbers(self) -> StructuredArray:
        """Return all records without what is raw."""
        return self._numbers.array()

    def pieces(self, rows: int = ROWS) -> Iterator[StructuredArray]:
        """Give the records piece by piece, raw frames as bytes objects."""
        numbers = self.numbers()
        if self._raw is None:
            yield from pieces(numbers, rows)
            return
        lengths, data, at = self._lengths.array(), self._bytes.array(), 0
        for start in range(0, len(numbers), rows):
            part, sizes = numbers[start : start + rows], lengths[start : start + rows]
            out = np.empty(len(part), self._dtype)
            for name in part.dtype.names or ():
                out[name] = part[name]
            ends = at + np.cumsum(sizes)
            content = data[at : int(ends[-1])].tobytes()
            frames = out[self._raw]
            for i, (end, size) in enumerate(zip((ends - at).tolist(), sizes.tolist())):
                frames[i] = content[end - size : end]
            at = int(ends[-1])
            yield out
            for column in (numbers, lengths, data):
                release(column)

    def array(self) -> StructuredArray:
        """Return all records as one array."""
        if self._raw is None:
            return self.numbers()
        parts = [*self.pieces()]
        return parts[0] if len(parts) == 1 else np.concatenate(parts) if parts else np.empty(0, self._dtype)
