"""Discrete-time Markov jump linear systems: the data, stability, and the three figures of merit.

    x(k+1) = A_i x(k) + B_i w(k),    z(k) = C_i x(k) + D_i w(k),    i = theta_k,  Pr{theta_{k+1} = j | i} = p_ij

Reference: Chapter 7, (7.14), Theorems 7.1, 7.2 and 7.4. The norms live in `h2` and `bounded_real`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.errors import FieldError
from design.jump_linear.periodic_chain import periodic_radius
from design.jump_linear.second_moment import Array
from design.processes.delay_chain import check_transition

STABILITY_MARGIN = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class MJLS:
    """A jump-linear system with mode-dependent matrices.

    Args:
        A: (N, n, n).
        B: (N, n, q) or (n, q).
        C: (N, l, n) or (l, n).
        transition: (N, N) row-stochastic.
        D: (N, l, q) or (l, q); default zero.

    A matrix without the mode axis is the same in every mode.

    Raises:
        FieldError: names the field at fault.
    """

    A: npt.ArrayLike
    B: npt.ArrayLike
    C: npt.ArrayLike
    transition: npt.ArrayLike
    D: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        matrix = check_transition(self.transition, "transition")
        N = matrix.shape[0]
        A = _stack(self.A, "A", N, None, None)
        n = A.shape[1]
        if A.shape[2] != n:
            raise FieldError("A", f"shape {A.shape}, expected square matrices")
        B = _stack(self.B, "B", N, n, None)
        C = _stack(self.C, "C", N, None, n)
        zero = np.zeros((C.shape[1], B.shape[2]))
        D = _stack(zero if self.D is None else self.D, "D", N, C.shape[1], B.shape[2])
        for name, value in (("A", A), ("B", B), ("C", C), ("D", D), ("transition", matrix)):
            object.__setattr__(self, name, value)

    @property
    def matrices(self) -> tuple[Array, Array, Array, Array, Array]:
        """(A, B, C, D, transition) as stacked arrays."""
        return tuple(np.asarray(m) for m in (self.A, self.B, self.C, self.D, self.transition))  # type: ignore[return-value]

    @property
    def modes(self) -> int:
        """Number of modes N."""
        return int(np.asarray(self.transition).shape[0])

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(np.asarray(self.A).shape[1])

    def radius(self, *, bounded: bool = True) -> float:
        """Spectral radius of the second-moment operator; mean-square stable iff < 1 (Theorem 7.1 made exact).

        Args:
            bounded: where no eigenvalue is found, return a bound on the radius's own side of 1, else nan.
        """
        A, _, _, _, transition = self.matrices
        return periodic_radius(A, transition, bounded=bounded)

    def alpha(self, initial: npt.ArrayLike | None = None) -> Array:
        """Initial mode distribution: uniform unless given.

        Raises:
            ValueError: not a distribution over the modes.
        """
        if initial is None:
            return np.full(self.modes, 1.0 / self.modes)
        alpha = np.asarray(initial, dtype=np.float64)
        if alpha.shape != (self.modes,):
            raise FieldError("initial", f"shape {alpha.shape}, expected ({self.modes},)")
        if not np.isfinite(alpha).all() or (alpha < 0).any() or abs(alpha.sum() - 1) > 1e-9:
            raise FieldError("initial", f"entries must be >= 0 and sum to 1, sum is {alpha.sum():.10g}")
        return alpha


def _stack(value: npt.ArrayLike, name: str, N: int, rows: int | None, columns: int | None) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.ndim == 2:
        array = np.repeat(array[None], N, axis=0)
    if array.ndim != 3 or array.shape[0] != N:
        raise FieldError(name, f"shape {array.shape}, expected {N} matrices")
    for axis, expected, what in ((1, rows, "rows"), (2, columns, "columns")):
        if expected is not None and array.shape[axis] != expected:
            raise FieldError(name, f"{array.shape[axis]} {what}, expected {expected}")
    if not np.isfinite(array).all():
        raise FieldError(f"{name}[{int(np.argwhere(~np.isfinite(array))[0][0])}]", "not finite")
    array.setflags(write=False)
    return array
