"""Several records in a row as one row of values, of which one at most is a frame: what is made once for every length of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Final, Generic, TypeVar

_MOST: Final = 64  # the lengths of frames may come from the link

Made = TypeVar("Made")


class ByFrameLength(Generic[Made]):
    """Keeps what rows need whose frame has the same length.

    Args:
        records: of each, in order, how many numbers it has, and whether a frame follows them.
        make: makes it for a length in bytes, 0 for rows without a frame.

    Attributes:
        count: values of a row.
        frame_at: which of them is the frame, None without one.

    Raises:
        ValueError: two of the records carry frames.
    """

    __slots__ = ("_made", "_make", "count", "frame_at")

    def __init__(self, records: Sequence[tuple[int, bool]], make: Callable[[int], Made]) -> None:
        frames = sum(frame for _, frame in records)
        if frames > 1:
            raise ValueError(f"records: {frames} carry frames, expected one at most")
        ends = [0, *accumulate(numbers + frame for numbers, frame in records)]
        self.count = ends[-1]
        self.frame_at = next((end - 1 for end, (_, frame) in zip(ends[1:], records) if frame), None)
        self._make = make
        self._made: dict[int, Made] = {}

    def of(self, length: int) -> Made:
        """Return it for frames of that length, bytes."""
        made = self._made.get(length)
        if made is None:
            if len(self._made) >= _MOST:
                self._made.clear()
            made = self._made[length] = self._make(length)
        return made
