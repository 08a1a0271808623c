"""The ages of slot after slot: what age laws with at most one step of memory draw."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import Final

import numpy as np

from transport.laws.stochastic_matrix import BLOCK

State = tuple[int, int]
"""Mode, and its age in slots."""


class ChainDraws:
    """A running chain: one uniform number a slot says which mode is next.

    Args:
        first: cumulative row of the mode in slot 0, see `cumulative`.
        rows: cumulative rows, one for every mode.
        ages: of the modes, slots.
        rng: the stream of the law.
    """

    def __init__(self, first: list[float], rows: Sequence[list[float]], ages: Sequence[int], rng: np.random.Generator) -> None:
        self._row, self._rows, self._rng = first, list(rows), rng
        self._states: Final[list[State]] = list(enumerate(ages))
        self._left = self._block()  # now: slot 0 does not pay for it

    def _block(self) -> list[float]:
        uniform: list[float] = self._rng.random(BLOCK).tolist()
        uniform.reverse()
        return uniform

    def draw(self) -> State:
        """Return mode and age of the next slot."""
        if not self._left:
            self._left = self._block()
        mode = bisect_right(self._row, self._left.pop())
        self._row = self._rows[mode]
        return self._states[mode]
