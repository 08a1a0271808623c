"""What plants are made of: linear models, exact propagation, friction, sensors, actuators, mode processes.

Here are a plant's signals and linear time-invariant models, in continuous and in discrete time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plants.errors import FieldError, PlantError
from plants.parts.exponential import zero_order_hold

if TYPE_CHECKING:
    import control


Matrix = NDArray[np.float64]

NS_PER_S = 1_000_000_000
NEVER_NS = 1 << 62
"""What does not come."""


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


INSTALL = "pip install 'hilrig[design]'"


def python_control() -> Any:
    """Return python-control.

    Raises:
        PlantError: it is not installed, with the command that installs it.
    """
    try:
        return import_module("control")
    except ModuleNotFoundError as error:
        if error.name != "control":
            raise
        raise PlantError(f"a model of python-control needs the package control, which is not installed: {INSTALL}") from None
