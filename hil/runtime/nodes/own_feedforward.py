"""What a controller adds of its own to its table: a feedforward may be anything that stays bounded while the reference stays.

A certificate is of what the controller makes of its samples. What it answers to samples of zero enters the loop as an input,
which moves a stable loop by a bounded amount if it is bounded itself. While the reference stays, the largest value so far is
looked at: one that rises in the last third of the time as fast as in the first, slot after slot, is not seen to have a bound.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

LEAST: Final = 60
"""Slots of one reference below which nothing is said."""
SHARE: Final = 0.9
"""Rise in the last third beside that in the first: 1 of a ramp, 0.9 of a filter 6 times slower than the time looked at."""
RISES: Final = 4
"""Slots of the last third in which a bounded one may reach a new largest value: steps of its own, and records of a noise."""
TIMES: Final = 2.5
"""How many times the largest value of the first third is passed: 3 by a ramp."""


class OwnFeedforward:
    """Keeps the largest value that was added so far, slot by slot, while one reference stays.

    Attributes:
        grown: the slot from which it rose without a bound, and how far; None while it did not.
    """

    def __init__(self) -> None:
        self._aim: Sequence[float] = ()
        self._first = 0
        self._largest = array("d")
        self.grown: tuple[int, str] | None = None

    def take(self, k: int, aim: Sequence[float], size: float) -> None:
        """Take the largest value that was added in a slot.

        Args:
            k: slot.
            aim: reference.
            size: largest absolute value over rows and inputs, in units of the inputs.
        """
        if aim != self._aim or not self._largest:
            self.judge()
            self._aim, self._first, self._largest = tuple(aim), k, array("d")
        last = self._largest[-1] if self._largest else 0.0
        self._largest.append(size if not size <= last else last)

    def judge(self) -> tuple[int, str] | None:
        """Return the slot from which it rose without a bound and how far, once the run or a reference has ended; else None."""
        seen = self._largest
        count, third = len(seen), len(seen) // 3
        if self.grown is not None or count < LEAST or not seen[-1] >= TIMES * seen[third - 1]:
            return self.grown
        tail = seen[-third - 1 :]
        least = 1e-9 * seen[-1]
        rises = sum(b - a > least for a, b in pairwise(tail))
        if rises > RISES and tail[-1] - tail[0] >= SHARE * (seen[third - 1] - seen[0]):
            grew = f"to {seen[third - 1]:.2g} in {third} slots and to {seen[-1]:.2g} in {count}"
            self.grown = self._first + count - third, f"what it adds on samples of zero, which grows {grew}"
        return self.grown
