"""What a summary needs of a log, kept as columns while the log is written: nothing is read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from hil.log.append_column import AppendColumn
from hil.log.records import CDR_HEADER, EVENTS_TOPIC, TIME_FIELD, Channel
from hil.log.write.open_chunk import Messages
from hil.log.write.packed_records import BEHIND, HEAD, MESSAGE_OVERHEAD

StructuredArray: TypeAlias = np.ndarray[Any, np.dtype[np.void]]
Keep: TypeAlias = Mapping[str, Sequence[str] | None]


class ColumnBuffer:
    """Columns of some topics, and all events, of the chunks of a log.

    Args:
        channels: the session's table.
        keep: topic to the fields that are kept, None for all; no topic with raw frames.
        folder: where those of a long run are kept, see `AppendColumn`.

    Attributes:
        schemas: of the topics, in full.

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
        self._messages = {topic: self._message(topic) for topic in keep}
        self._columns = {topic: AppendColumn(self._dtype(topic), folder) for topic in keep}
        self._ids: Mapping[str, int] = {}
        self._events, self._lengths = AppendColumn(np.uint8, folder), AppendColumn(np.int64, folder)

    def number(self, ids: Mapping[str, int]) -> None:
        """Say under which number a topic stands in the file."""
        self._ids = ids

    def take(self, data: bytes, messages: Messages) -> None:
        """Keep what is to be kept of one chunk; see `McapWriter`."""
        if not self._any:
            return
        for topic, message in self._messages.items():
            own = messages.get(self._ids[topic])
            if own is None:
                continue
            column = self._columns[topic]
            everywhere = np.ndarray(len(data) - message.itemsize + 1, message, data, strides=1)  # a message at every byte
            records = everywhere[own.begins]
            part = np.empty(len(records), column.dtype)
            part[TIME_FIELD] = own.times
            for name in self._fields[topic]:
                part[name] = records[name]
            column.extend(part)
        events = messages.get(self._ids[EVENTS_TOPIC])
        for at in () if events is None else events.begins.tolist():
            length = HEAD.unpack_from(data, at)[1]
            payload = data[at + MESSAGE_OVERHEAD : at + MESSAGE_OVERHEAD - BEHIND + length]
            self._events.extend(np.frombuffer(payload, np.uint8))
            self._lengths.extend(np.array([len(payload)], np.int64))

    def events(self) -> list[bytes]:
        """Return the payloads of `/events`."""
        data, ends = self._events.array(), np.cumsum(self._lengths.array())
        return [data[begin:end].tobytes() for begin, end in zip([0, *ends.tolist()], ends.tolist())]

    def _numbers(self, topic: str) -> Mapping[str, Any]:
        return self.schemas[topic].dtype.fields or {}

    def _dtype(self, topic: str) -> np.dtype[np.void]:
        numbers = self._numbers(topic)
        return np.dtype([(TIME_FIELD, "<i8"), *((name, numbers[name][0]) for name in self._fields[topic])])

    def _message(self, topic: str) -> np.dtype[np.void]:
        """The fields that are kept, where they stand in a message: behind its head and the CDR header."""
        numbers, payload = self._numbers(topic), MESSAGE_OVERHEAD + len(CDR_HEADER)
        fields = {name: (numbers[name][0], payload + numbers[name][1]) for name in self._fields[topic]}
        return np.dtype(
            {
                "names": list(fields),
                "formats": [kind for kind, _ in fields.values()],
                "offsets": [at for _, at in fields.values()],
                "itemsize": payload + self.schemas[topic].dtype.itemsize,
            }
        )

    def arrays(self) -> dict[str, StructuredArray]:
        """Return what was kept, topic to records; the columns are empty afterwards."""
        found = {topic: column.array() for topic, column in self._columns.items()}
        self._columns = {topic: AppendColumn(column.dtype) for topic, column in self._columns.items()}
        return found
