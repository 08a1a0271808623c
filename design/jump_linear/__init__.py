"""Discrete-time Markov jump linear systems, with no network in them: the data, stability, norms, certificates.

Here are the data, and the H2 norm with its exact derivative; the H-infinity norm is in `bounded_real`.

    x(k+1) = A_i x(k) + B_i w(k),    z(k) = C_i x(k) + D_i w(k),    i = theta_k,  Pr{theta_{k+1} = j | i} = p_ij

The H2 norm is that of coupled Lyapunov equations, with alpha the distribution of the mode at k = 0, when the impulse enters:

    S_i = A_i' E_i(S) A_i + C_i' C_i,   E_i(S) = sum_j p_ij S_j                                  (7.21)
    ||H||_2^2 = sum_i alpha_i tr{ B_i' E_i(S) B_i + D_i' D_i }                                   (7.20)

DEVIATION: (7.19) prints || E z ||^2 and a sum over s twice; what (7.20)-(7.21) compute, and what is meant, is the sum
over k of E |z(k)|^2. Both definitions can be computed: `definition="mean"` sums |E z(k)|^2 as printed.

Reference: Chapter 7, (7.14), Theorems 7.1 and 7.2.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import force_setattr

from design.errors import FieldError, NotStable
from design.jump_linear.coupled_lyapunov import factors_of, mean, solve_coupled, transposed_factors
from design.jump_linear.order_of_modes import periodic_radius
from design.jump_linear.second_moment import Array, Resolvent, expect
from design.jump_linear.stability_proof import StabilityProof, is_positive
from design.processes.delay_chain import check_transition

STABILITY_MARGIN = 1e-9


class MJLS(Struct, frozen=True, kw_only=True):
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
            force_setattr(self, name, value)

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


Definition = Literal["energy", "mean"]


class H2Derivative(NamedTuple):
    """Squared H2 norm, its Lyapunov solutions, and its derivative with respect to the mode matrices."""

    square: float
    S: Array
    X: Array
    gradient_A: Array


def h2_norm(system: MJLS, initial: npt.ArrayLike | None = None, *, definition: Definition = "energy") -> float:
    """H2 norm (7.19)-(7.21).

    Args:
        system: the jump-linear system; must be mean-square stable.
        initial: (N,) distribution of the mode at the impulse; default uniform.
        definition: "energy" sums E|z|^2 (Theorem 7.2), "mean" sums |E z|^2 as (7.19) is printed, each initial mode
            taken separately as printed.

    Raises:
        NotStable: the radius is not below 1.
    """
    radius = system.radius()
    if radius >= 1.0:
        raise NotStable(f"H2 norm: not mean-square stable, radius {radius:.6g}, expected < 1", value=radius)
    alpha = system.alpha(initial)
    if definition == "mean":
        return _mean_norm(system, alpha)
    A, B, C, D, transition = system.matrices
    S = Resolvent(A, transition).cost(C.transpose(0, 2, 1) @ C)
    energy = B.transpose(0, 2, 1) @ expect(transition, S) @ B + D.transpose(0, 2, 1) @ D
    return float(np.sqrt(np.einsum("i,ijj->", alpha, energy)))


def impulse_moments(B: Array, transition: Array, alpha: Array) -> Array:
    """Second moment of the state one step after a unit impulse on each input in turn: sum_i p_ij alpha_i B_i B_i'."""
    return np.asarray(np.tensordot(transition, alpha[:, None, None] * (B @ B.transpose(0, 2, 1)), axes=(0, 0)))


def h2_derivative(A: Array, B: Array, C: Array, transition: Array, alpha: Array) -> H2Derivative | None:
    """Squared H2 norm (D = 0) and its derivative, or None if the system is not mean-square stable.

    With X the accumulated covariance, X = L* X + sum_i p_ij alpha_i B_i B_i',

        d ||H||^2 / d A_i = 2 E_i(S) A_i X_i,      d ||H||^2 / d C_i = 2 C_i X_i.

    Stability is decided by the solution for the cost I: it is positive definite if and only if the radius is < 1.
    """
    resolvent = Resolvent(A, transition)
    identity = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    S, probe = resolvent.cost(np.stack([C.transpose(0, 2, 1) @ C, identity]))
    if not is_positive(probe):
        return None
    X = resolvent.covariance(impulse_moments(B, transition, alpha))
    CX = C @ X
    gradient_A = 2.0 * expect(transition, S) @ A @ X
    return H2Derivative(float(np.sum(CX * C)), S, X, gradient_A)


def _mean_norm(system: MJLS, alpha: Array) -> float:
    """Sum over k, inputs and initial modes of |E z(k)|^2, from the first-moment operator."""
    A, B, C, D, transition = system.matrices
    N, n, q = B.shape
    step = np.einsum("ij,iab->jaib", transition, A).reshape(N * n, N * n)
    output = C.transpose(1, 0, 2).reshape(-1, N * n)
    import scipy.linalg

    gram = scipy.linalg.solve_discrete_lyapunov(step.T, output.T @ output)
    total = 0.0
    for i in range(N):
        start = np.einsum("j,as->jas", transition[i], B[i]).reshape(N * n, q)
        total += alpha[i] * float(np.trace(start.T @ gram @ start) + np.sum(D[i] ** 2))
    return float(np.sqrt(total))


TOLERANCE = 1e-10


class H2Nearby:
    """Squared H2 norm and derivative of loops that differ little from one call to the next.

    It is for a descent over many modes: every solve starts where the last one ended.

    The solutions E = E(S) and X of the two Lyapunov equations are found to a tolerance t only. The value takes both of them,

        ||H||_2^2 = <C'C, X> + <S, V + L* X - X>,    V_j = sum_i p_ij alpha_i B_i B_i',

    whose error is the product of theirs, of the order t^2; the derivative has the error t.

    Args:
        B, C: (N, n, q), (N, l, n).
        transition: (N, N) row-stochastic matrix.
        alpha: (N,) distribution of the mode at the impulse.
    """

    def __init__(self, B: Array, C: Array, transition: Array, alpha: Array) -> None:
        self._cost = factors_of(transition)
        self._covariance = transposed_factors(self._cost)
        self._weight = C.transpose(0, 2, 1) @ C
        self._impulse = impulse_moments(B, transition, alpha)
        self._proof = StabilityProof(transition)
        self._E: Array | None = None
        self._X: Array | None = None

    def derivative(self, A: Array) -> H2Derivative | None:
        """As `design.jump_linear.h2_derivative`: None if the system is not mean-square stable, or too near to tell."""
        if not self._proof.holds(A):
            return None
        turned = np.ascontiguousarray(A.transpose(0, 2, 1))
        X = solve_coupled(A, self._covariance, self._impulse, tolerance=TOLERANCE, near=self._X)
        E = solve_coupled(turned, self._cost, mean(self._cost, self._weight), tolerance=TOLERANCE, near=self._E)
        if X is None or E is None:
            return None
        self._X, self._E = X, E
        S = turned @ E @ A + self._weight
        gap = self._impulse + mean(self._covariance, A @ X @ turned) - X
        square = float(np.vdot(self._weight, X) + np.vdot(S, gap))
        return H2Derivative(square, S, X, 2.0 * (E @ A @ X))
