"""The frames of the pipe: head and record, several of them packed by one `struct`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from struct import Struct
from typing import Any, Final

from hil.log.records import CDR_HEADER, Channel
from hil.log.write.frame_length import ByFrameLength

HEAD: Final = Struct("<IHqq")
"""Head of a frame: length of the record, number of its channel, nominal time in ns, how much later it happened in ns."""

_SIZE_AND_NUMBER: Final = Struct("<IH")

Layout = tuple[Callable[..., bytes], Callable[[tuple[Any, ...]], tuple[Any, ...]], tuple[Any, ...]]
"""What packs, what puts time, delay, constants and values in order, and the constants."""


class PipeBlock:
    """Packs one record of each of some channels at once.

    Args:
        channels: in order; one of them at most carries frames.

    Raises:
        ValueError: two of them carry frames.
    """

    def __init__(self, channels: Sequence[Channel]) -> None:
        self._channels = tuple(channels)
        made = ByFrameLength([(len(channel.schema.codes), channel.schema.raw) for channel in channels], self._layout)
        self._values, self._frame_at, self._layout_of = made.count, made.frame_at, made.of

    def pack(self, t_ns: int, behind_ns: int, values: Sequence[Any]) -> bytes:
        """Return the records as they go into the pipe.

        Args:
            t_ns: nominal time of all of them, ns.
            behind_ns: how much later they happened, ns.
            values: the numbers of the first record, of the second, and so on; the bytes of a frame stand behind its numbers.

        Raises:
            TypeError: not as many values as the records have.
        """
        if len(values) != self._values:
            raise TypeError(f"{len(values)} values, expected {self._values} in {len(self._channels)} records")
        length = 0 if self._frame_at is None else len(values[self._frame_at])
        pack, order, constants = self._layout_of(length)
        return pack(*order((t_ns, behind_ns, *constants, *values)))

    def _layout(self, length: int) -> Layout:
        constants: list[Any] = [CDR_HEADER]
        order, codes = [], ""
        value = 3 + sum(2 if channel.schema.raw else 1 for channel in self._channels)  # behind the instants and the constants
        for channel in self._channels:
            schema = channel.schema
            own = f"4s{schema.codes}" + (f"{-schema.dtype.itemsize % 4}xI{length}s" if schema.raw else "")
            constants.append(_SIZE_AND_NUMBER.pack(Struct(f"<{own}").size, channel.id))
            order += [1 + len(constants), 0, 1, 2, *range(value, value + len(schema.codes))]
            value += len(schema.codes)
            if schema.raw:
                constants.append(length)
                order += [1 + len(constants), value]
                value += 1
            codes += f"{_SIZE_AND_NUMBER.size}sqq{own}"
        return Struct(f"<{codes}").pack, itemgetter(*order), tuple(constants)


def frames_in(data: bytes) -> int:
    """Return how many frames there are in bytes that hold whole ones only.

    >>> frames_in(HEAD.pack(2, 1, 0, 0) + b"ab" + HEAD.pack(0, 1, 0, 0))
    2
    """
    at = count = 0
    while at < len(data):
        at += HEAD.size + HEAD.unpack_from(data, at)[0]
        count += 1
    return count
