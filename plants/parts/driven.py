"""A running linear plant whose actuators saturate, and that random forces drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from plants.parts.draws import Normals
from plants.parts.linear import NS_PER_S, LinearRun, StateSpace


class DrivenRun:
    r"""A running plant x' = A x + B (sat(u) + w) + G v, y = C x, with v held over steps of a grid in time.

    v is normal with variance 1/h in every step of length h, new with every step: white for what is slower than the grid. It is
    drawn as time passes the grid's instants, so that two advances are one of their sum.

    Args:
        model: the equations.
        initial_state: x at time 0, n entries.
        limits: largest magnitude of every input, m entries; none if empty.
        intensity: diagonal of G, n entries, in the state's unit per root of a second; none if empty.
        step_ns: h in ns.
        rng: source of v.
    """

    __slots__ = ("_applied", "_left_ns", "_limits", "_noise", "_normals", "_root", "_run", "_step_ns")

    def __init__(
        self,
        model: StateSpace,
        initial_state: Sequence[float],
        *,
        limits: Sequence[float],
        intensity: Sequence[float],
        step_ns: int,
        rng: np.random.Generator,
    ) -> None:
        B = np.hstack([model.B, np.diag(intensity)]) if len(intensity) else model.B
        self._run = LinearRun(StateSpace(A=model.A, B=B, C=model.C), initial_state)
        self._limits, self._step_ns, self._normals = tuple(limits), step_ns, Normals(rng)
        self._root = math.sqrt(NS_PER_S / step_ns)
        self._noise: list[float] = [0.0] * len(intensity)
        self._left_ns = 0
        self._applied: tuple[float, ...] = (0.0,) * int(model.B.shape[1])

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the input sat(u) + w for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded input, m entries.
            w: disturbance at the input, m entries, or nothing.
        """
        v = tuple(min(max(a, -limit), limit) for a, limit in zip(u, self._limits)) if self._limits else tuple(u)
        self._applied = v
        held = [a + b for a, b in zip(v, w)] if w else list(v)
        if not self._noise:
            self._run.advance(dt_ns, held)
            return
        while dt_ns > 0:
            if self._left_ns == 0:
                self._noise = [self._root * v for v in self._normals.several(len(self._noise))]
                self._left_ns = self._step_ns
            span = min(dt_ns, self._left_ns)
            self._run.advance(span, held + self._noise)
            self._left_ns -= span
            dt_ns -= span

    def measure(self) -> tuple[float, ...]:
        """Return y = C x."""
        return self._run.measure()

    @property
    def state(self) -> tuple[float, ...]:
        """The state x."""
        return self._run.state

    @property
    def applied(self) -> tuple[float, ...]:
        """What the actuators put out in the last advance, without the disturbance."""
        return self._applied
