"""Plants that run a linear model exactly, in plain floats: alone, with saturated actuators, forces and noise, or many at once.

Many runs at once have bit for bit what `LinearRun` computes alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from plants.errors import PlantError
from plants.parts import NS_PER_S, Matrix, StateSpace
from plants.parts.draws import Normals
from plants.parts.flow import Flow

if TYPE_CHECKING:
    from plants.parts.protocols import PlantRun


Outputs = tuple[tuple[tuple[int, float], ...], ...]


def _parts(model: StateSpace) -> tuple[Flow, Outputs]:
    """The motion of a model, and of every output the states that it shows and their weights."""
    if model.D.any():
        raise PlantError("model.D: not zero; a rig measures y(k) before u(k) exists")
    outputs = tuple(tuple((i, c) for i, c in enumerate(row) if c != 0.0) for row in model.C.tolist())
    return Flow(model.A.tolist(), model.B.tolist()), outputs


class LinearRun:
    """A running linear plant: x' = A x + B (u + w), y = C x, in plain floats.

    Args:
        model: the equations; D must be zero, as a rig samples before it applies.
        initial_state: x at time 0, n entries.

    Raises:
        PlantError: an initial state of another length.
    """

    __slots__ = ("_applied", "_flow", "_outputs", "_x")

    def __init__(self, model: StateSpace, initial_state: Sequence[float]) -> None:
        self._flow, self._outputs = _parts(model)
        self._x = [float(x) for x in initial_state]
        if len(self._x) != len(model.A):
            raise PlantError(f"initial_state: {len(self._x)} numbers, expected {len(model.A)}, one for each state")
        self._applied: tuple[float, ...] = (0.0,) * model.B.shape[1]

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
        self._run = LinearRun(_with_forces(model, intensity), initial_state)
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

    def change(self, model: StateSpace, limits: Sequence[float], intensity: Sequence[float]) -> None:
        """Go on under other equations, limits and forces, as many forces as before; the random numbers go on."""
        self._run, self._limits = LinearRun(_with_forces(model, intensity), self.state), tuple(limits)

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


def _with_forces(model: StateSpace, intensity: Sequence[float]) -> StateSpace:
    return StateSpace(A=model.A, B=np.hstack([model.B, np.diag(intensity)]), C=model.C) if len(intensity) else model


class NoisyRun:
    """A plant that measures y = C x + e, e normal and independent from sample to sample.

    The noise is drawn as time passes, so that two measurements at one instant agree.

    Args:
        run: the plant.
        noise_sd: standard deviation of every entry of e, or one for each, in the unit of the output.
        rng: source of the noise.
    """

    __slots__ = ("_noise", "_noise_sd", "_normals", "_run")

    def __init__(self, run: PlantRun, noise_sd: float | Sequence[float], rng: np.random.Generator) -> None:
        self._run, self._normals = run, Normals(rng)
        outputs = len(run.measure())
        self._noise_sd = (float(noise_sd),) * outputs if isinstance(noise_sd, int | float) else tuple(map(float, noise_sd))
        self._noise = self._draw()

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the input u + w for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded input, m entries.
            w: disturbance at the input, m entries, or nothing.
        """
        self._run.advance(dt_ns, u, w)
        if dt_ns:
            self._noise = self._draw()

    @property
    def inner(self) -> PlantRun:
        """The plant behind the noise."""
        return self._run

    def change(self, run: PlantRun, noise_sd: Sequence[float]) -> None:
        """Measure another run, with other noise from the next draw on; the random numbers go on."""
        self._run, self._noise_sd = run, tuple(map(float, noise_sd))

    def measure(self) -> tuple[float, ...]:
        """Return y = C x + e."""
        return tuple(y + e for y, e in zip(self._run.measure(), self._noise))

    @property
    def state(self) -> tuple[float, ...]:
        """The state x, without noise."""
        return self._run.state

    @property
    def applied(self) -> tuple[float, ...]:
        """What the actuator put out in the last advance, without the disturbance."""
        return self._run.applied

    def _draw(self) -> tuple[float, ...]:
        return tuple(sd * v for sd, v in zip(self._noise_sd, self._normals.several(len(self._noise_sd))))


class LinearRuns:
    """Running linear plants: x' = A x + B (u + w), y = C x; as `LinearRun`, the sums in the same order.

    Args:
        model: the equations; D must be zero.
        initial_state: x at time 0, n entries, of every run.
        runs: how many.
    """

    def __init__(self, model: StateSpace, initial_state: Sequence[float], runs: int) -> None:
        self._flow, self._outputs = _parts(model)
        self.state: Matrix = np.repeat(np.array(initial_state, dtype=np.float64)[:, None], runs, axis=1)

    def advance(self, dt_ns: int, u: Matrix, w: Sequence[float]) -> None:
        """Hold the inputs u (m, runs) and the disturbance w (m,) for dt_ns."""
        held = (*self.state, *(a + b for a, b in zip(u, w)))
        after = np.zeros_like(self.state)
        for total, row in zip(after, self._flow.rows(dt_ns)):
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
