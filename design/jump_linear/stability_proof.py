"""Mean-square stability of loops that differ little, proved each time: by the last Lyapunov family, as long as it serves.

R > 0 with R - L R > 0 proves it. One equation solved to few digits gives such an R; a product tells whether it still fits.
"""

from __future__ import annotations

import numpy as np

from design.jump_linear.coupled_lyapunov import solve_coupled
from design.jump_linear.joint_expectation import Array, factors_of, mean

TOLERANCES = (1e-4, 1e-12)


class StabilityProof:
    """Keeps the last family that proved stability.

    Args:
        transition: (N, N) row-stochastic matrix.
    """

    def __init__(self, transition: Array) -> None:
        self._factors = factors_of(transition)
        self._family: Array | None = None
        self._expected: Array | None = None

    def holds(self, A: Array) -> bool:
        """Whether the mode matrices (N, n, n) are proved mean-square stable; False where they are not, or too near to tell."""
        turned = np.ascontiguousarray(A.transpose(0, 2, 1))
        if self._family is not None and self._falls(self._family, A, turned):
            return True
        identity = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
        for tolerance in TOLERANCES:
            expected = solve_coupled(turned, self._factors, identity, tolerance=tolerance, near=self._expected)
            if expected is None:
                return False
            family = turned @ expected @ A + identity
            if self._falls(family, A, turned):
                if not is_positive(family):
                    return False
                self._family, self._expected = family, expected
                return True
        return False

    def _falls(self, family: Array, A: Array, turned: Array) -> bool:
        return is_positive(family - turned @ mean(self._factors, family) @ A)


def is_positive(family: Array) -> bool:
    """Whether every matrix of a symmetric family (N, n, n) is positive definite."""
    if not np.isfinite(family).all():
        return False
    try:
        np.linalg.cholesky(family)
    except np.linalg.LinAlgError:
        return False
    return True
