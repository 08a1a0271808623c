"""Coupled bounded-real (Riccati) equations of a jump-linear system at one gamma, and their smallest solution.

    P_i = A_i' E_i(P) A_i + C_i' C_i + G_i' V_i^-1 G_i,   G_i = B_i' E_i(P) A_i + D_i' C_i,
    V_i = gamma^2 I - B_i' E_i(P) B_i - D_i' D_i > 0

Reference: (7.28) with equality; the smallest gamma for which they have a solution is found by `bounded_real`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.jump_linear.second_moment import DENSE_LIMIT, Array, Resolvent, expect
from design.jump_linear.stability_proof import StabilityProof, is_positive

NEWTON_STEPS = 40
TOLERANCE, ROUNDED = 1e-11, 1e-8
"""Relative Newton steps: one at which it ends, and one after which steps that no longer fall are rounding (radius near 1)."""
Matrices = tuple[Array, Array, Array, Array, Array]
"""A, B, C, D and the transition matrix."""


class Policy(NamedTuple):
    """A solution of the bounded-real equations at one gamma: P, worst disturbance F, closed-loop matrices, V."""

    P: Array
    F: Array
    A: Array
    C: Array
    V: Array


def solve_bounded_real(matrices: Matrices, square: float, extra: float = 0.0, near: Policy | None = None) -> Policy | None:
    """Smallest solution of the bounded-real equations at gamma^2 = `square`, or None if gamma is not above the norm.

    Newton's method from w = 0, every step one coupled Lyapunov equation; its iterates rise to the solution.
    `extra` adds extra * I to C_i' C_i, which makes (7.28) strict at the result. `near` is a solution at a larger gamma:
    its disturbance leaves the loop stable here too, and Newton's method rises from there in fewer steps.
    """
    A, B, C, _, transition = matrices
    identity = extra * np.eye(A.shape[-1])
    policy: Policy | None = None
    moved = np.inf
    closed, output = A, C
    F = np.zeros((A.shape[0], B.shape[2], A.shape[1]))
    if near is not None:
        F, closed, output = near.F, near.A, near.C
    ones = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    proof = StabilityProof(transition) if many(matrices) else None
    for _ in range(NEWTON_STEPS):
        weight = output.transpose(0, 2, 1) @ output - square * (F.transpose(0, 2, 1) @ F) + identity
        if proof is None:
            P, probe = Resolvent(closed, transition).cost(np.stack([weight, ones]))
            stable = is_positive(probe)
        else:
            stable = proof.holds(closed)
            last = policy or near
            P = Resolvent(closed, transition).cost(weight, near=last.P if last else None) if stable else weight
        if not stable or not np.isfinite(P).all():
            return None
        previous = policy
        policy = policy_at(matrices, P, square)
        if policy is None:
            return None
        if previous is not None:
            before, moved = moved, float(np.abs(P - previous.P).max() / (np.abs(P).max() + 1e-300))
            if moved <= TOLERANCE or (before <= ROUNDED and moved >= 0.5 * before):
                return policy
        F, closed, output = policy.F, policy.A, policy.C
    return None


def many(matrices: Matrices) -> bool:
    """Whether GMRES solves the equations: then every product counts, and each solve starts from another one's result."""
    modes, n, _ = matrices[0].shape
    return bool(modes > 1 and modes * n * (n + 1) // 2 > DENSE_LIMIT)


def policy_at(matrices: Matrices, P: Array, square: float) -> Policy | None:
    """The worst disturbance against the cost P at gamma^2, and the loop under it; None where V is not positive definite."""
    A, B, C, D, transition = matrices
    E = expect(transition, P)
    BE = B.transpose(0, 2, 1) @ E
    V = square * np.eye(B.shape[2]) - BE @ B - D.transpose(0, 2, 1) @ D
    if not is_positive(V):
        return None
    F = np.asarray(np.linalg.solve(V, BE @ A + D.transpose(0, 2, 1) @ C), dtype=np.float64)
    return Policy(P, F, A + B @ F, C + D @ F, V)
