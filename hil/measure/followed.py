"""Outputs and the reference that they shall follow, read in blocks: a long run is never whole in memory."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.measure.pairwise_sum import LEAF

Array: TypeAlias = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """Times, outputs and reference of the slots that have both.

    Args:
        slots: how many there are, n.
        of: returns times in s (j - i,), outputs and reference (j - i, p) each, of the slots from i to j - 1.
    """

    slots: int
    of: Callable[[int, int], tuple[Array, Array, Array]]

    def blocks(self, begin: int = 0, end: int | None = None) -> Iterator[tuple[int, int]]:
        """Give the bounds of blocks, in order."""
        end = self.slots if end is None else end
        for i in range(begin, end, LEAF):
            yield i, min(i + LEAF, end)

    def time(self, slot: int) -> float:
        """Return the time of a slot, s."""
        return float(self.of(slot, slot + 1)[0][0])

    def reference(self, slot: int) -> Array:
        """Return the reference in a slot, (p,)."""
        row: Array = self.of(slot, slot + 1)[2][0]
        return row

    def first_at(self, t_s: float) -> int:
        """Return the first slot that is not before an instant, n if all are."""
        return bisect_left(range(self.slots), t_s, key=self.time)

    def changes(self, most: int) -> list[int]:
        """Return the first slots at which the reference differs from that of the slot before, so many at most."""
        found: list[int] = []
        for i, j in self.blocks():
            before = max(i - 1, 0)
            r = self.of(before, j)[2]
            found += (np.flatnonzero(np.any(r[1:] != r[:-1], axis=1)) + before + 1).tolist()
            if len(found) >= most:
                break
        return found[:most]
