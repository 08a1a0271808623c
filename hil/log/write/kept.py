"""What a summary needs of a log, kept as columns while the log is written: nothing is read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.log.growing import Growing
from hil.log.records import CDR_HEADER, EVENTS_TOPIC, TIME_FIELD, Channel
from hil.log.write.mcap_writer import MESSAGE_OVERHEAD, Heads

StructuredArray: TypeAlias = np.ndarray[Any, np.dtype[np.void]]
Keep: TypeAlias = Mapping[str, Sequence[str] | None]


class Kept:
    """Columns of some topics, and all events, of the chunks of a log.

    Args:
        channels: the session's table.
        keep: topic to the fields that are kept, None for all; no topic with raw frames.
        folder: where those of a long run are kept, see `Growing`.

    Attributes:
        schemas: of the topics, in full.
        events: payloads of `/events`.

    Raises:
        ValueError: a topic that the session does not have, or that holds raw frames.
    """

    def __init__(self, channels: Mapping[str, Channel], keep: Keep, folder: Path | None = None) -> None:
        for topic in keep:
            if topic not in channels or channels[topic].schema.raw:
                raise ValueError(f"keep: {topic!r} is no topic of numbers in the table of channels")
        self._any = bool(keep)
        self.schemas = {topic: channels[topic].schema for topic in keep}
        self._fields = {
            topic: list((self.schemas[topic].dtype.names or ()) if fields is None else fields) for topic, fields in keep.items()
        }
        self._columns = {topic: Growing(self._dtype(topic), folder) for topic in keep}
        self._ids: Mapping[str, int] = {}
        self.events: list[bytes] = []

    def number(self, ids: Mapping[str, int]) -> None:
        """Say under which number a topic stands in the file."""
        self._ids = ids

    def take(self, heads: Heads, data: bytes, begins: npt.NDArray[np.int64]) -> None:
        """Keep what is to be kept of one chunk; see `McapWriter`."""
        if not self._any:
            return
        raw, channels = np.frombuffer(data, np.uint8), heads["channel"]
        for topic, schema in self.schemas.items():
            own = channels == self._ids[topic]
            at = begins[own] + MESSAGE_OVERHEAD + len(CDR_HEADER)
            records = raw[at[:, None] + np.arange(schema.dtype.itemsize)].view(schema.dtype)[:, 0]
            part = np.empty(len(records), self._dtype(topic))
            part[TIME_FIELD] = heads["log"][own]
            for name in self._fields[topic]:
                part[name] = records[name]
            self._columns[topic].extend(part)
        for begin, length in zip(*(a[channels == self._ids[EVENTS_TOPIC]].tolist() for a in (begins, heads["length"]))):
            self.events.append(data[begin + MESSAGE_OVERHEAD : begin + 9 + length])

    def _dtype(self, topic: str) -> np.dtype[np.void]:
        numbers: Mapping[str, Any] = self.schemas[topic].dtype.fields or {}
        return np.dtype([(TIME_FIELD, "<i8"), *((name, numbers[name][0]) for name in self._fields[topic])])

    def arrays(self) -> dict[str, StructuredArray]:
        """Return what was kept, topic to records; the columns are empty afterwards."""
        found = {topic: column.array() for topic, column in self._columns.items()}
        self._columns = {topic: Growing(column.dtype) for topic, column in self._columns.items()}
        return found
