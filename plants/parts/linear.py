"""Linear time-invariant models, and plants that run one exactly, in plain floats: one run, or many at once.

Many runs at once have bit for bit what `LinearRun` computes alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plants.errors import FieldError, PlantError
from plants.parts.control_package import python_control
from plants.parts.exponential import Rows, drift, zero_order_hold

if TYPE_CHECKING:
    import control


Matrix = NDArray[np.float64]

NS_PER_S = 1_000_000_000
_CACHED_STEPS = 64  # a rig uses one or two lengths; the bound only stops a caller that uses a new one every time


class Signal(NamedTuple):
    """Name and unit of one entry of a state, input or output vector, as it stands in the log."""

    name: str
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, init=False)
class StateSpace:
    """Continuous-time model x' = A x + B u, y = C x + D u.

    Args:
        A: n x n.
        B: n x m.
        C: p x n.
        D: p x m; zero if left out.

    Raises:
        ValueError: where a shape does not fit or an entry is not finite.

    >>> integrator = StateSpace(A=[[0]], B=[[1]], C=[[1]])
    >>> integrator.discretise(0.5).B
    array([[0.5]])
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix

    def __init__(self, *, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None) -> None:
        for name, matrix in zip("ABCD", _checked(A, B, C, D)):
            object.__setattr__(self, name, matrix)

    def discretise(self, period_s: float) -> DiscreteStateSpace:
        """Return the exact zero-order-hold model x(k+1) = exp(A T) x(k) + int_0^T exp(A s) ds B u(k).

        Args:
            period_s: sample period T in seconds, above 0.

        Raises:
            PlantError: where T is not a finite number above 0, or exp(A T) is too large for a float.
        """
        if not 0 < period_s < math.inf:
            raise PlantError(f"discretise: period {period_s!r} s, expected a finite number > 0")
        Phi, Gamma = zero_order_hold(self.A.tolist(), self.B.tolist(), float(period_s).as_integer_ratio())
        return DiscreteStateSpace(A=Phi, B=Gamma, C=self.C, D=self.D, period_s=period_s)

    def to_control(self) -> control.StateSpace:
        """Return the model as a `control.StateSpace` (imports python-control, which no rig process may do)."""
        return python_control().ss(self.A, self.B, self.C, self.D)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, init=False)
class DiscreteStateSpace:
    """Discrete-time model x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k).

    Args:
        A: n x n.
        B: n x m.
        C: p x n.
        D: p x m; zero if left out.
        period_s: sample period T in seconds.

    Raises:
        ValueError: where a shape does not fit or an entry is not finite.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    period_s: float

    def __init__(self, *, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None, period_s: float) -> None:
        if not 0 < period_s < math.inf:
            raise FieldError("period_s", f"{period_s!r}, expected a finite number > 0")
        for name, matrix in zip("ABCD", _checked(A, B, C, D)):
            object.__setattr__(self, name, matrix)
        object.__setattr__(self, "period_s", float(period_s))

    def discretise(self, period_s: float) -> DiscreteStateSpace:
        """Return the model itself, which has its own period.

        Raises:
            PlantError: another period is asked for.
        """
        if period_s != self.period_s:
            raise PlantError(f"discretise: {period_s:g} s, but the plant is given in slots of {self.period_s:g} s")
        return self

    def to_control(self) -> control.StateSpace:
        """Return the model as a `control.StateSpace` with this period (imports python-control, see above)."""
        return python_control().ss(self.A, self.B, self.C, self.D, self.period_s)


def _checked(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    a, b, c = (np.array(M, dtype=np.float64) for M in (A, B, C))
    if a.ndim != 2 or a.shape[0] != a.shape[1]:
        raise FieldError("A", f"shape {a.shape}, expected a square matrix")
    n = a.shape[0]
    if b.ndim != 2 or b.shape[0] != n:
        raise FieldError("B", f"shape {b.shape}, expected ({n}, m)")
    if c.ndim != 2 or c.shape[1] != n:
        raise FieldError("C", f"shape {c.shape}, expected (p, {n})")
    shape = (c.shape[0], b.shape[1])
    d = np.zeros(shape) if D is None else np.array(D, dtype=np.float64)
    if d.shape != shape:
        raise FieldError("D", f"shape {d.shape}, expected {shape}")
    for name, M in zip("ABCD", (a, b, c, d)):
        if not np.isfinite(M).all():
            row, column = (int(i) for i in np.argwhere(~np.isfinite(M))[0])
            raise FieldError(f"{name}[{row}][{column}]", f"{M[row, column]}, expected a finite number")
        M.setflags(write=False)
    return a, b, c, d


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
