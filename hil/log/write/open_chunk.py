"""The messages of an MCAP chunk while it is open: rows as they come, which become messages when it ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.log.write.packed_records import TIMES_AT, Layout, Layouts

_MAX_ALIKE = 1024  # the lengths of messages may come from the link

Integers = npt.NDArray[np.uint64]


class Placed(NamedTuple):
    """The messages of one channel in a chunk, in order.

    Attributes:
        times: log time of each, ns.
        begins: where in the chunk the head of each begins.
    """

    times: Integers
    begins: Integers


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
        self._layouts: list[Layout] = []  # of every row
        self._alike: dict[tuple[int, int], Layout] = {}
        self.size = self.refused = 0
        self.closed = False

    def __len__(self) -> int:
        """Return how many messages there are."""
        return sum(len(layout.channels) for layout in self._layouts)

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
            layout = self._alike[channel_id, size] = Layout((channel_id,), (0,), size, TIMES_AT)
        self._rows.append(message)
        self._layouts.append(layout)
        self.size += size

    def adds(self, layouts: Layouts) -> Callable[..., None]:
        """Return the function that takes a row: its time in ns, 0 where it is less, and its values."""
        at, layout_of, count, messages = layouts.frame_at, layouts.of, layouts.count, layouts.messages
        keep, note = self._rows.append, self._layouts.append
        length = 0  # of the last frame
        pack, layout = layout_of(length)

        def add(t_ns: int, *values: Any) -> None:
            nonlocal length, pack, layout
            if self.closed:
                self.refused += messages
                return
            if len(values) != count:
                raise TypeError(f"{len(values)} values, expected {count} in {messages} records")
            if at is not None and len(values[at]) != length:
                length = len(values[at])
                pack, layout = layout_of(length)
            if t_ns < 0:
                t_ns = 0
            keep(pack(t_ns, t_ns, *values))
            note(layout)
            self.size += layout.size

        return add

    def end(self, opening: bytes) -> tuple[bytes, Messages]:
        """Return the bytes of the chunk, and where in them its messages stand; the next chunk is open then.

        Args:
            opening: what stands before the first message.
        """
        rows, layouts = self._rows, self._layouts
        sizes = np.fromiter([layout.size for layout in layouts], np.uint64, len(layouts))
        begins = np.cumsum(sizes) - sizes + np.uint64(len(opening))
        own: dict[Layout, list[int]] = {}
        for i, layout in enumerate(layouts):
            own.setdefault(layout, []).append(i)
        found: dict[int, list[Placed]] = {}
        for layout, numbers in own.items():
            packed = np.frombuffer(b"".join([rows[i] for i in numbers]), np.uint8).reshape(len(numbers), -1)
            times = packed[:, layout.time_at : layout.time_at + 8].copy().view("<u8").ravel()
            at = begins[numbers]
            for channel, begin in zip(layout.channels, layout.begins):
                found.setdefault(channel, []).append(Placed(times, at + np.uint64(begin)))
            if layout.spread is not None:
                spread, size = layout.spread(packed), layout.size
                for i, start in zip(numbers, range(0, len(spread), size)):
                    rows[i] = spread[start : start + size]
        data = b"".join((opening, *rows))
        rows.clear()  # the same lists: the functions of `adds` append to them
        layouts.clear()
        self.size = 0
        placed = [(channel, _in_order(parts)) for channel, parts in found.items()]
        placed.sort(key=lambda of_channel: int(of_channel[1].begins[0]))
        return data, dict(placed)


def _in_order(parts: list[Placed]) -> Placed:
    if len(parts) == 1:
        return parts[0]
    times, begins = (np.concatenate(column) for column in zip(*parts))
    order = np.argsort(begins)
    return Placed(times[order], begins[order])
