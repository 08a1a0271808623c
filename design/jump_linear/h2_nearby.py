"""Squared H2 norm and its derivative along a descent over many modes: every solve starts where the last one ended.

The solutions E = E(S) and X of the two Lyapunov equations are found to a tolerance t only. The value takes both of them,

    ||H||_2^2 = <C'C, X> + <S, V + L* X - X>,    V_j = sum_i p_ij alpha_i B_i B_i',

whose error is the product of theirs, of the order t^2; the derivative has the error t.
"""

from __future__ import annotations

import numpy as np

from design.jump_linear.coupled_lyapunov import solve_coupled
from design.jump_linear.h2 import H2Derivative, impulse_moments
from design.jump_linear.joint_expectation import factors_of, mean, transposed_factors
from design.jump_linear.second_moment import Array
from design.jump_linear.stability_proof import StabilityProof

TOLERANCE = 1e-10


class H2Nearby:
    """Squared H2 norm and derivative of loops that differ little from one call to the next.

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
        self._C = C
        self._proof = StabilityProof(transition)
        self._E: Array | None = None
        self._X: Array | None = None

    def derivative(self, A: Array) -> H2Derivative | None:
        """As `design.jump_linear.h2.h2_derivative`: None if the system is not mean-square stable, or too near to tell."""
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
        return H2Derivative(square, S, X, 2.0 * (E @ A @ X), 2.0 * (self._C @ X))
