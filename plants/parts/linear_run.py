"""Plants that run a linear model exactly, in plain floats: one run, or many at once.

Many runs at once have bit for bit what `LinearRun` computes alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plants.errors import PlantError
from plants.parts.exponential import zero_order_hold
from plants.parts.flow import Flow
from plants.parts.linear import NS_PER_S, Matrix, StateSpace


class LinearRun:
    """A running linear plant: x' = A x + B (u + w), y = C x, in plain floats.

    Args:
        model: the equations; D must be zero, as a rig samples before it applies.
        initial_state: x at time 0, n entries.
    """

    __slots__ = ("_applied", "_flow", "_outputs", "_x")

    def __init__(self, model: StateSpace, initial_state: Sequence[float]) -> None:
        if model.D.any():
            raise PlantError("model.D: not zero; a rig measures y(k) before u(k) exists")
        self._flow = Flow(model.A.tolist(), model.B.tolist())
        self._x = [float(x) for x in initial_state]
        self._applied: tuple[float, ...] = (0.0,) * model.B.shape[1]
        self._outputs = tuple(tuple((i, c) for i, c in enumerate(row) if c != 0.0) for row in model.C.tolist())

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the input u + w for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded input, m entries.
            w: disturbance at the input, m entries, or nothing.
        """
        self._applied = tuple(u)
        self._x = self._flow.step(self._x, [a + b for a, b in zip(u, w)] if w else u, dt_ns)

    def measure(self) -> tuple[float, ...]:
        """Return y = C x."""
        y = []
        for row in self._outputs:
            total = 0.0
            for i, c in row:
                total += c * self._x[i]
            y.append(total)
        return tuple(y)

    @property
    def state(self) -> tuple[float, ...]:
        """The state x."""
        return tuple(self._x)

    @property
    def applied(self) -> tuple[float, ...]:
        """What the actuator put out in the last advance, without the disturbance."""
        return self._applied


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
