"""Many runs of one linear plant at once, each bit for bit what `LinearRun` computes alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plants.errors import PlantError
from plants.parts.exponential import zero_order_hold
from plants.parts.linear import NS_PER_S, Matrix, StateSpace


class LinearRuns:
    """Running linear plants: x' = A x + B (u + w), y = C x; as `LinearRun`, the sums in the same order.

    Args:
        model: the equations; D must be zero.
        initial_state: x at time 0, n entries, of every run.
        runs: how many.
    """

    def __init__(self, model: StateSpace, initial_state: Sequence[float], runs: int) -> None:
        if model.D.any():
            raise PlantError("model.D: not zero; a rig measures y(k) before u(k) exists")
        self._A, self._B = model.A.tolist(), model.B.tolist()
        self._outputs = [[(i, c) for i, c in enumerate(row) if c != 0.0] for row in model.C.tolist()]
        self._dt_ns = -1
        self._rows: list[tuple[float, ...]] = []
        self.state: Matrix = np.repeat(np.array(initial_state, dtype=np.float64)[:, None], runs, axis=1)

    def advance(self, dt_ns: int, u: Matrix, w: Sequence[float]) -> None:
        """Hold the inputs u (m, runs) and the disturbance w (m,) for dt_ns."""
        if dt_ns != self._dt_ns:
            Phi, Gamma = zero_order_hold(self._A, self._B, (dt_ns, NS_PER_S))
            self._rows, self._dt_ns = [p + g for p, g in zip(Phi, Gamma)], dt_ns
        held = (*self.state, *(a + b for a, b in zip(u, w)))
        after = np.zeros_like(self.state)
        for total, row in zip(after, self._rows):
            for a, b in zip(row, held):
                total += a * b
        self.state = after

    def measure(self) -> Matrix:
        """Return y = C x, (p, runs)."""
        y = np.zeros((len(self._outputs), self.state.shape[1]))
        for total, row in zip(y, self._outputs):
            for i, c in row:
                total += c * self.state[i]
        return y
