"""A signal that is constant between slots in which it changes: a reference, a disturbance."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from typing import Final

_FAR: Final = 1 << 60
"""Slots beyond every run."""


class Piecewise:
    """Looked up where a piece begins, and kept until it ends.

    Args:
        start: value until the first change.
        changes: slot to the value from there on.

    >>> signal = Piecewise((0.0,), {2: (1.0,)})
    >>> [signal.at(k) for k in range(4)]
    [(0.0,), (0.0,), (1.0,), (1.0,)]
    """

    def __init__(self, start: tuple[float, ...], changes: Mapping[int, tuple[float, ...]]) -> None:
        self._edges = sorted(changes)
        self._values = [start, *(changes[k] for k in self._edges)]
        self._begin = self._end = 0
        self._value = start

    def at(self, k: int) -> tuple[float, ...]:
        """Return the value in slot k."""
        if not self._begin <= k < self._end:
            edges, piece = self._edges, bisect_right(self._edges, k)
            self._begin = edges[piece - 1] if piece else -_FAR
            self._end = edges[piece] if piece < len(edges) else _FAR
            self._value = self._values[piece]
        return self._value
