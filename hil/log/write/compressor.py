"""zstd that takes its memory once: what it has does not follow the bursts of what it gets.

One context of zstd takes what the longest data so far asked for, and from its 129th use on it gives back what is more than three
times that of the next. A session whose chunks differ in length would grow and shrink by 0.9 MB. Here every length has the context
of its power of two.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import zstandard

SHORTEST: Final = 10
"""Binary digits of the lengths that have the first context."""


class Compressor:
    """Compresses chunks, each by itself, to the frames that one context makes.

    Args:
        room: bytes up to which a chunk finds all memory taken; longer ones take more when they come.
    """

    def __init__(self, room: int = 0) -> None:
        self._contexts: dict[int, zstandard.ZstdCompressor] = {}
        for digits in range(SHORTEST, max(room - 1, 0).bit_length() + 1):
            for data in _touching(1 << digits):
                self._context(digits).compress(data)

    @property
    def memory(self) -> int:
        """Bytes that zstd has taken."""
        return sum(context.memory_size() for context in self._contexts.values())

    def compress(self, data: bytes) -> bytes:
        """Return a frame of zstd."""
        return self._context(max(SHORTEST, (len(data) - 1).bit_length())).compress(data)

    def _context(self, digits: int) -> zstandard.ZstdCompressor:
        context = self._contexts.get(digits)
        if context is None:
            context = self._contexts[digits] = zstandard.ZstdCompressor()
        return context


def _touching(length: int) -> tuple[bytes, ...]:
    """Return data of which nothing repeats, and data of which much does, so that zstd writes to all of its memory."""
    number = np.arange(length, dtype=np.uint32) * np.uint32(2654435761)
    mixed = (number ^ number >> np.uint32(15)) * np.uint32(2246822519)
    return tuple((mixed >> np.uint32(bits)).astype(np.uint8).tobytes() for bits in (24, 29))
