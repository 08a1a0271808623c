"""A signal that is constant between slots in which it changes: a reference, a disturbance."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping


class Piecewise:
    """Values by slot: that of the last change.

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

    def at(self, k: int) -> tuple[float, ...]:
        """Return the value in slot k."""
        return self._values[bisect_right(self._edges, k)]
