"""The exact motion of a linear system under a held input, in plain floats."""

from __future__ import annotations

import math
from collections.abc import Sequence

from plants.errors import PlantError
from plants.parts.exponential import Rows, drift, zero_order_hold
from plants.parts.linear import NS_PER_S

_CACHED_STEPS = 64  # a rig uses one or two lengths; the bound only stops a caller that uses a new one every time


class Flow:
    """The motion of x' = A x + B v under a held v, exact for any length of time.

    Args:
        A: n x n rows.
        B: n x m rows; what is held is the one vector v (inputs and, where there are any, disturbances).
    """

    __slots__ = ("_A", "_B", "_norm", "_steps")

    def __init__(self, A: Sequence[Sequence[float]], B: Sequence[Sequence[float]]) -> None:
        self._A: Rows = tuple(tuple(float(a) for a in row) for row in A)
        self._B: Rows = tuple(tuple(float(b) for b in row) for row in B)
        self._norm = max(math.fsum(map(abs, row)) for row in self._A)
        self._steps: dict[int, Rows] = {}

    def prepare(self, dt_ns: int) -> None:
        """Compute the matrix of a length that will come, so that no later `step` has to (it takes up to 1 ms)."""
        if dt_ns not in self._steps:
            self._tabulate(dt_ns)

    def rows(self, dt_ns: int) -> Rows:
        """Return the rows of that matrix: x after dt_ns is, from the left, the sum of their products with x and v."""
        return self._steps.get(dt_ns) or self._tabulate(dt_ns)

    def step(self, x: Sequence[float], v: Sequence[float], dt_ns: int) -> list[float]:
        """Return x after dt_ns, by a matrix that is computed once for every length: for the sample period."""
        rows, held = self.rows(dt_ns), (*x, *v)
        after = []
        for row in rows:
            total = 0.0
            for a, b in zip(row, held):
                total += a * b
            after.append(total)
        return after

    def drift(self, x: Sequence[float], v: Sequence[float], dt_ns: int) -> list[float]:
        """Return x after dt_ns, by a series: for the odd lengths between random events."""
        force = []
        for row in self._B:
            total = 0.0
            for a, b in zip(row, v):
                total += a * b
            force.append(total)
        return drift(self._A, self._norm, x, force, dt_ns / NS_PER_S)

    def _tabulate(self, dt_ns: int) -> Rows:
        if dt_ns < 0:
            raise PlantError(f"advance: {dt_ns} ns, expected a time that does not run backwards")
        if len(self._steps) >= _CACHED_STEPS:
            self._steps.clear()
        Phi, Gamma = zero_order_hold(self._A, self._B, (dt_ns, NS_PER_S))
        rows = tuple(p + g for p, g in zip(Phi, Gamma))
        self._steps[dt_ns] = rows
        return rows
