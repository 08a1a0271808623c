"""The messages of an MCAP chunk while it is open: rows that become messages when it ends, and columns that a summary needs.

Nothing of the log is read back for the summary.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from hil.log.append_column import AppendColumn
from hil.log.records import CDR_HEADER, EVENTS_TOPIC, TIME_FIELD, Channel
from hil.log.write import mcap_records as mcap
from hil.log.write.pipe_sink import ByFrameLength

_MAX_ALIKE = 1024  # the lengths of messages may come from the link


class Placed(NamedTuple):
    """The messages of one channel in a chunk, in order.

    Attributes:
        times: log time of each, ns.
        begins: where in the chunk the head of each begins.
    """

    times: mcap.Integers
    begins: mcap.Integers


Messages = dict[int, Placed]
"""The messages of a chunk by their channels, which come in the order of their first messages."""


class OpenChunk:
    """Rows of messages in the order in which they will stand in the file.

    Attributes:
        size: bytes of the messages.
        closed: set it, and no message is taken any more.
        refused: how many came since.
    """

    def __init__(self) -> None:
        self._rows: list[bytes] = []
        self._layouts: list[mcap.Layout] = []  # of every row
        self._alike: dict[tuple[int, int], mcap.Layout] = {}
        self.size = self.refused = 0
        self.closed = False

    def __len__(self) -> int:
        """Return how many messages there are."""
        return sum(len(layout.places) for layout in self._layouts)

    def add(self, channel_id: int, message: bytes) -> None:
        """Take one message, head included."""
        if self.closed:
            self.refused += 1
            return
        size = len(message)
        layout = self._alike.get((channel_id, size))
        if layout is None:
            if len(self._alike) >= _MAX_ALIKE:
                self._alike.clear()
            layout = self._alike[channel_id, size] = mcap.Layout(mcap.places((channel_id,), (0,)), size, size, mcap.TIMES_AT)
        self._rows.append(message)
        self._layouts.append(layout)
        self.size += size

    def adds(self, rows: ByFrameLength[mcap.Made]) -> Callable[[int, Sequence[Any]], None]:
        """Return the function that takes a row: its time in ns, 0 where it is less, and its values.

        They are the numbers of the first record, of the second, and so on; the bytes of a frame stand behind its numbers.
        """
        at, messages = rows.frame_at, rows.messages

        def add(t_ns: int, values: Sequence[Any]) -> None:
            if self.closed:
                self.refused += messages
                return
            t_ns = max(t_ns, 0)
            try:
                pack, layout = rows.of(0 if at is None else len(values[at]))
                self._rows.append(pack(t_ns, t_ns, *values))
            except (struct.error, LookupError, TypeError):
                rows.refuse_others(values)
                raise
            self._layouts.append(layout)
            self.size += layout.size

        return add

    def end(self, opening: bytes) -> tuple[bytes, Messages, int, int]:
        """Return the chunk, which takes no more; the next one is open then.

        Args:
            opening: what stands before the first message.

        Returns:
            its bytes, where in them its messages stand, and the smallest and the largest log time, ns.
        """
        rows, layouts = self._rows, self._layouts
        kinds = np.fromiter(map(id, layouts), np.uint64, len(layouts))
        own = {layout: (kinds == id(layout)).nonzero()[0] for layout in dict.fromkeys(layouts)}
        sizes = np.empty(len(rows), np.uint64)
        for layout, numbers in own.items():
            sizes[numbers] = layout.size
        begins = sizes.cumsum() - sizes + np.uint64(len(opening))
        data = np.empty(len(opening) + self.size, np.uint8)
        data[: len(opening)] = np.frombuffer(opening, np.uint8)
        where, times = [], []
        for layout, numbers in own.items():
            packed, at, width = b"".join([rows[i] for i in numbers.tolist()]), begins[numbers], layout.width
            messages = np.frombuffer(packed, f"V{width}") if layout.spread is None else layout.spread(packed)
            everywhere = np.ndarray(len(data) - layout.size + 1, messages.dtype, data, strides=1)  # a row at every byte
            everywhere[at] = messages
            where.append((at[:, np.newaxis] + layout.places).ravel())
            times.append(np.ndarray(len(at), "<u8", packed, layout.time_at, width).repeat(len(layout.places)))
        rows.clear()  # the same lists: the functions of `adds` append to them
        layouts.clear()
        self.size = 0
        when = np.concatenate(times)
        return data.tobytes(), _by_channel(np.concatenate(where), when), int(when.min()), int(when.max())


def _by_channel(where: mcap.Integers, times: mcap.Integers) -> Messages:
    order = where.argsort()
    where, times = where[order], times[order]
    channels, begins = where >> mcap.BEGIN, where & mcap.WITHIN
    edges = [0, *((channels[1:] != channels[:-1]).nonzero()[0] + 1).tolist(), len(channels)]
    found = [(int(channels[a]), Placed(times[a:b], begins[a:b])) for a, b in pairwise(edges)]
    found.sort(key=lambda of_channel: int(of_channel[1].begins[0]))
    return dict(found)


StructuredArray: TypeAlias = np.ndarray[Any, np.dtype[np.void]]
Keep: TypeAlias = Mapping[str, Sequence[str] | None]


class ColumnBuffer:
    """Columns of some topics, and all events, of the chunks of a log.

    Args:
        channels: the session's table.
        ids: under which number a topic stands in the file, filled in before the first chunk ends.
        keep: topic to the fields that are kept, None for all; no topic with raw frames.
        folder: where those of a long run are kept, see `AppendColumn`.

    Attributes:
        schemas: of the topics, in full.

    Raises:
        ValueError: a topic that the session does not have, or that holds raw frames.
    """

    def __init__(self, channels: Mapping[str, Channel], ids: Mapping[str, int], keep: Keep, folder: Path) -> None:
        for topic in keep:
            if topic not in channels or channels[topic].schema.raw:
                raise ValueError(f"keep: {topic!r} is no topic of numbers in the table of channels")
        self._any = bool(keep)
        self.schemas = {topic: channels[topic].schema for topic in keep}
        self._messages: dict[str, np.dtype[np.void]] = {}  # the fields that are kept, where they stand in a message
        self._columns: dict[str, AppendColumn] = {}
        payload = mcap.MESSAGE_OVERHEAD + len(CDR_HEADER)  # begins behind the head of a message and the CDR header
        for topic, fields in keep.items():
            dtype = self.schemas[topic].dtype
            numbers: Mapping[str, Any] = dtype.fields or {}
            names = [*(numbers if fields is None else fields)]
            formats, offsets = [numbers[name][0] for name in names], [payload + numbers[name][1] for name in names]
            layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": payload + dtype.itemsize}
            self._messages[topic] = np.dtype(layout)  # type: ignore[call-overload]
            self._columns[topic] = AppendColumn([(TIME_FIELD, "<i8"), *zip(names, formats)], folder)
        self._ids = ids
        self._events, self._lengths = AppendColumn(np.uint8, folder), AppendColumn(np.int64, folder)

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
            for name in message.names or ():
                part[name] = records[name]
            column.extend(part)
        events = messages.get(self._ids[EVENTS_TOPIC])
        for at in () if events is None else events.begins.tolist():
            length = mcap.HEAD.unpack_from(data, at)[1]
            payload = data[at + mcap.MESSAGE_OVERHEAD : at + mcap.MESSAGE_OVERHEAD - mcap.BEHIND + length]
            self._events.extend(np.frombuffer(payload, np.uint8))
            self._lengths.extend(np.array([len(payload)], np.int64))

    def events(self) -> list[bytes]:
        """Return the payloads of `/events`."""
        data, ends = self._events.array(), np.cumsum(self._lengths.array())
        return [data[begin:end].tobytes() for begin, end in zip([0, *ends.tolist()], ends.tolist())]

    def arrays(self) -> dict[str, StructuredArray]:
        """Return what was kept, topic to records; the columns are empty afterwards."""
        found = {topic: column.array() for topic, column in self._columns.items()}
        self._columns = {topic: AppendColumn(column.dtype) for topic, column in self._columns.items()}
        return found
