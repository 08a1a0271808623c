"""Coupled Lyapunov equations over many modes, matrix-free.

    Y = W (M Y M') + G

M_i = A_i and W = P' give the covariance; M_i = A_i' and W = P the expected cost-to-go E_i(S), with G_i = E_i(Q).
"""

from __future__ import annotations

import numpy as np

from design.jump_linear import krylov
from design.jump_linear.joint_expectation import Array, Factors
from design.jump_linear.shift_states import ShiftStates


def solve_coupled(
    M: Array, factors: Factors, G: Array, *, tolerance: float = 1e-13, near: Array | None = None
) -> Array | None:
    """Return the solution (N, n, n), or None where none was found.

    Args:
        M: (N, n, n).
        factors: W as two chains, see `design.jump_linear.joint_expectation`.
        G: (N, n, n) symmetric.
        tolerance: of the residual, as a share of the right-hand side.
        near: (N, n, n) solution of an equation nearby, to start from.
    """
    states = ShiftStates(M, factors)
    G, f = states.arranged(G), states.free
    right = G[:, :f]
    if states.stages:
        right = right + states.moved(states.expand(np.zeros(states.shape), G))

    def product(vector: Array) -> Array:
        return vector - states.pack(states.moved(states.expand(states.unpack(vector))))

    start = None if near is None else states.pack(states.arranged(near)[:, :f])
    found = krylov.solve(product, states.pack(right), tolerance=tolerance, start=start)
    return None if found is None else states.restored(states.expand(states.unpack(found), G))


def solve_bordered(
    M: Array,
    factors: Factors,
    G: tuple[Array, Array],
    functional: Array,
    level: tuple[float, float],
    *,
    tolerance: float = 1e-13,
    near: Array | None = None,
) -> tuple[Array, float] | None:
    """Return Y (N, n, n) and t with Y = W (M Y M') + G_0 + t G_1 and <H, Y> = c_0 + t c_1, or None where none were found.

    Args:
        M, factors, tolerance, near: as in `solve_coupled`.
        G: (G_0, G_1), each (N, n, n) symmetric.
        functional: H (N, n, n) symmetric.
        level: (c_0, c_1).
    """
    states = ShiftStates(M, factors)
    G0, G1, H, f = states.arranged(G[0]), states.arranged(G[1]), states.arranged(functional), states.free
    along = states.pack(G1[:, :f])

    def product(vector: Array) -> Array:
        Y = states.expand(states.unpack(vector[:-1]), vector[-1] * G1 if states.stages else None)
        rows = vector[:-1] - states.pack(states.moved(Y)) - vector[-1] * along
        return np.append(rows, vector[-1] * level[1] - np.vdot(H, Y))

    known, offset = G0[:, :f], -level[0]
    if states.stages:
        fixed = states.expand(np.zeros(states.shape), G0)
        known, offset = known + states.moved(fixed), offset + float(np.vdot(H, fixed))
    start = None if near is None else np.append(states.pack(states.arranged(near)[:, :f]), 0.0)
    found = krylov.solve(product, np.append(states.pack(known), offset), tolerance=tolerance, start=start)
    if found is None:
        return None
    t = float(found[-1])
    return states.restored(states.expand(states.unpack(found[:-1]), G0 + t * G1 if states.stages else None)), t
