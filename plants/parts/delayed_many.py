"""Many runs of one discrete plant with delays of its state, each bit for bit what `DelayedStatesRun` computes alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plants.parts.exponential import Rows
from plants.parts.linear import Matrix


class DelayedStatesRuns:
    """x(k+1) = A x(k) + A_1 x(k-1) + ... + B (u(k) + w(k)) in many runs, the sums in the same order.

    Args:
        A: n rows of n entries.
        delayed: A_1, A_2, ..., likewise.
        B: n rows of m entries.
        past: x(0), x(-1), ..., one after the other.
        period_ns: length of a slot, ns; it steps when a whole slot has passed.
        runs: how many.
    """

    def __init__(
        self, A: Rows, delayed: Sequence[Rows], B: Rows, past: Sequence[float], period_ns: int, runs: int
    ) -> None:  # fmt: skip
        self._rows = [[a for matrix in (A, *delayed) for a in matrix[i]] for i in range(len(A))]
        self._input, self._n = B, len(A)
        self._past: Matrix = np.repeat(np.array(past, dtype=np.float64)[:, None], runs, axis=1)
        self._period_ns, self._passed_ns = period_ns, 0

    @property
    def state(self) -> Matrix:
        """x(k), (n, runs); a new array after every step."""
        return self._past[: self._n]

    def advance(self, dt_ns: int, u: Matrix, w: Sequence[float]) -> None:
        """Hold u (m, runs) and w (m,) for dt_ns; what is held when a slot ends has acted in it."""
        self._passed_ns += dt_ns
        while self._passed_ns >= self._period_ns:
            self._passed_ns -= self._period_ns
            held = [a + b for a, b in zip(u, w)]
            x = np.stack([_dot(row, self._past) + _dot(force, held) for row, force in zip(self._rows, self._input)])
            self._past = np.concatenate((x, self._past[: len(self._past) - self._n]))

    def measure(self) -> Matrix:
        """Return x(k), (n, runs)."""
        return self.state


def _dot(row: Sequence[float], columns: Sequence[Matrix] | Matrix) -> Matrix:
    total = np.zeros(columns[0].shape)
    for a, column in zip(row, columns):
        total += a * column
    return total
