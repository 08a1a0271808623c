"""A discrete plant with several delays of its own state (5.1), by default the example of Section 5.4; in one run or many.

Many runs at once have bit for bit what `DelayedStatesRun` computes alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from plants.errors import FieldError, require_not_negative, require_rows, require_vector, require_whole_nanoseconds
from plants.parts import NS_PER_S, DiscreteStateSpace, Matrix, Signal
from plants.parts.exponential import Rows, dot
from plants.parts.linear_run import NoisyRun

A_5_4: Final[Rows] = (
    (0.8, 0.1, -0.016, -0.5),
    (0.0, 0.5, -0.337, -0.017),
    (0.0, 0.0, 1.1, 0.2),
    (0.0, 0.0, 0.024, 0.09),
)
DELAYED_5_4: Final[tuple[Rows, ...]] = (
    (
        (-0.0044, 0.052, -0.0356, 0.1662),
        (-0.0806, -0.123, 0.0276, -0.1278),
        (0.0932, -0.0848, 0.0194, -0.042),
        (-0.0632, -0.157, 0.029, 0.0024),
    ),
    (
        (-0.044, -0.0111, -0.038, 0.0035),
        (-0.0122, 0.0228, -0.0411, -0.0494),
        (0.0547, 0.0532, -0.0769, 0.0438),
        (0.0, 0.0185, -0.0083, -0.0243),
    ),
    (
        (-0.0171, 0.0435, -0.0405, 0.023),
        (-0.0001, 0.0061, -0.0487, 0.0059),
        (-0.0154, 0.0398, -0.0362, 0.005),
        (0.001, -0.0439, -0.0201, -0.0359),
    ),
    (
        (-0.0542, -0.0265, 0.0115, -0.0217),
        (0.03, -0.0113, 0.0773, 0.0064),
        (-0.0037, -0.0119, -0.0001, -0.0033),
        (0.0246, 0.0241, 0.0023, -0.0351),
    ),
    (
        (0.0025, 0.0032, -0.004, 0.0017),
        (0.0013, -0.0006, -0.0004, 0.0067),
        (-0.0043, 0.0011, -0.0041, -0.0011),
        (0.0085, -0.0032, -0.0014, -0.0012),
    ),
)
B_5_4: Final[Rows] = ((0.0045,), (0.0896,), (-0.0068,), (-0.1377,))
START_5_4: Final = (-4.0, 3.0, -6.0, 1.0)
WEIGHT_5_4: Final[Rows] = ((0.1, 0.0, 0.0, 0.0), (0.0, 0.1, 0.0, 0.0), (0.0, 0.0, 0.1, 0.0), (0.0, 0.0, 0.0, 0.1))


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayedStates:
    """The plant x(k+1) = A x(k) + A_1 x(k-1) + ... + A_tau x(k-tau) + B (u(k) + w(k)), every state measured.

    The thesis states no period; slots last ``period_s``. What was before slot 0 acts on the plant, and no sensor has seen it.

    Args:
        A: n rows of n entries.
        delayed: the tau matrices A_1, ..., A_tau, each of n rows of n entries.
        B: n rows of m entries.
        initial_state: x(0), n entries.
        period_s: length of a slot, s; the experiment's period must be the same.
        weight: Xi of the cost, sum of x' Xi x + u' Xi_u u, n rows of n entries; that of the example if left out.
        input_weight: Xi_u, m rows of m entries; zero if left out.
        initial_history: x(-1), x(-2), ..., at most tau rows of n entries; what is left out was zero.
        noise_sd: standard deviation of white noise on every measured state, n entries, at least 0; none if left out.

    Raises:
        ValueError: a shape that does not fit, or an entry that is not finite, or negative noise.

    Reference: thesis (5.1), (5.3), (5.18), Section 5.4.
    """

    A: Rows = A_5_4
    delayed: tuple[Rows, ...] = DELAYED_5_4
    B: Rows = B_5_4
    initial_state: tuple[float, ...] = START_5_4
    period_s: float = 0.05
    weight: Rows = WEIGHT_5_4
    input_weight: Rows = ()
    initial_history: Rows = ()
    noise_sd: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        require_rows("A", self.A)
        require_rows("B", self.B)
        n = len(self.A)
        model = self.model()
        for j, rows in enumerate(self.delayed):
            _square(f"delayed[{j}]", rows, n)
        _square("weight", self.weight, n)
        if self.input_weight:
            _square("input_weight", self.input_weight, model.B.shape[1])
        require_vector("initial_state", self.initial_state, n)
        if len(self.initial_history) > len(self.delayed):
            most = len(self.delayed)
            raise FieldError("initial_history", f"{len(self.initial_history)} rows, expected at most {most}, one a delay")
        for h, row in enumerate(self.initial_history):
            require_vector(f"initial_history[{h}]", row, n)
        if self.noise_sd:
            require_vector("noise_sd", self.noise_sd, n)
            for i, deviation in enumerate(self.noise_sd):
                require_not_negative(f"noise_sd[{i}]", deviation)
        require_whole_nanoseconds("period_s", self.period_s)

    @property
    def states(self) -> tuple[Signal, ...]:
        """x1, x2, ..., pure numbers."""
        return tuple(Signal(f"x{i + 1}", "1") for i in range(len(self.A)))

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """The states."""
        return self.states

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """u1, u2, ..., pure numbers."""
        return tuple(Signal(f"u{i + 1}", "1") for i in range(len(self.B[0]) if self.B else 0))

    def model(self) -> DiscreteStateSpace:
        """Return A, B and the measured state; the delayed states are in `state_delays`."""
        return DiscreteStateSpace(A=self.A, B=self.B, C=np.eye(len(self.A)), period_s=self.period_s)

    def state_delays(self) -> Matrix:
        """Return A_1, ..., A_tau, (tau, n, n)."""
        n = len(self.A)
        return np.array(self.delayed, dtype=np.float64).reshape(len(self.delayed), n, n)

    def cost_weights(self) -> tuple[Matrix, Matrix]:
        """Return Xi, (n, n), and Xi_u, (m, m)."""
        m = len(self.inputs)
        return np.array(self.weight), np.array(self.input_weight) if self.input_weight else np.zeros((m, m))

    def state_history(self) -> Matrix:
        """Return x(-1), ..., x(-tau), (tau, n)."""
        history = np.zeros((len(self.delayed), len(self.A)))
        history[: len(self.initial_history)] = np.array(self.initial_history).reshape(-1, len(self.A))
        return history

    def sensor_noise(self) -> Matrix:
        """Return the standard deviation of the noise on every output, (n,)."""
        return np.array(self.noise_sd) if self.noise_sd else np.zeros(len(self.A))

    def rows(self) -> list[list[float]]:
        """Return a row for every state over x(k), x(k-1), ..., one after the other."""
        return [[a for matrix in (self.A, *self.delayed) for a in matrix[i]] for i in range(len(self.A))]

    def past(self) -> list[float]:
        """Return x(0), x(-1), ..., one after the other."""
        return [*map(float, self.initial_state), *self.state_history().ravel().tolist()]

    def start(self, rng: np.random.Generator) -> DelayedStatesRun | NoisyRun:
        """Return the plant at slot 0; without noise it draws nothing from ``rng``."""
        run = DelayedStatesRun(self)
        return NoisyRun(run, self.noise_sd, rng) if any(self.noise_sd) else run

    def start_batch(self, runs: int) -> DelayedStatesRuns | None:
        """Return so many plants at slot 0; None where noise is drawn."""
        if any(self.noise_sd):
            return None
        return DelayedStatesRuns(self, runs)


def _square(path: str, rows: Rows, n: int) -> None:
    if len(rows) != n:
        raise FieldError(path, f"{len(rows)} rows, expected {n}")
    for i, row in enumerate(rows):
        require_vector(f"{path}[{i}]", row, n)


class DelayedStatesRun:
    """The plant while it runs, in plain floats; it steps when a whole slot has passed."""

    def __init__(self, plant: DelayedStates) -> None:
        self._rows, self._input = plant.rows(), plant.B
        self._n, self._past = len(plant.A), plant.past()
        self._period_ns, self._passed_ns = round(plant.period_s * NS_PER_S), 0
        self._applied = (0.0,) * len(plant.inputs)

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold u + w for dt_ns; what is held when a slot ends has acted in it.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded input, m entries.
            w: disturbance at the input, m entries, or nothing.
        """
        self._applied = tuple(u)
        self._passed_ns += dt_ns
        while self._passed_ns >= self._period_ns:
            self._passed_ns -= self._period_ns
            held = [a + b for a, b in zip(u, w)] if w else u
            x = [dot(row, self._past) + dot(force, held) for row, force in zip(self._rows, self._input)]
            self._past = [*x, *self._past[: len(self._past) - self._n]]

    def measure(self) -> tuple[float, ...]:
        """Return x(k)."""
        return self.state

    @property
    def state(self) -> tuple[float, ...]:
        """x(k)."""
        return tuple(self._past[: self._n])

    @property
    def applied(self) -> tuple[float, ...]:
        """What the actuator put out in the last advance, without the disturbance."""
        return self._applied


class DelayedStatesRuns:
    """The plant in many runs, the sums in the same order.

    Args:
        plant: its parameters.
        runs: how many.
    """

    def __init__(self, plant: DelayedStates, runs: int) -> None:
        self._rows, self._input, self._n = plant.rows(), plant.B, len(plant.A)
        self._past: Matrix = np.repeat(np.array(plant.past())[:, None], runs, axis=1)
        self._period_ns, self._passed_ns = round(plant.period_s * NS_PER_S), 0

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
            x = np.stack([_dot_many(row, self._past) + _dot_many(force, held) for row, force in zip(self._rows, self._input)])
            self._past = np.concatenate((x, self._past[: len(self._past) - self._n]))

    def measure(self) -> Matrix:
        """Return x(k), (n, runs)."""
        return self.state


def _dot_many(row: Sequence[float], columns: Sequence[Matrix] | Matrix) -> Matrix:
    total = np.zeros(columns[0].shape)
    for a, column in zip(row, columns):
        total += a * column
    return total
