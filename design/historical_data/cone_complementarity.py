r"""Theorem 5.1, its functional put right, by cone complementarity: the thesis's own scheme, with every answer checked.

.. math:: \min \operatorname{tr}(P_k X + X_k P), \qquad \begin{bmatrix} P & I \\ I & X \end{bmatrix} \ge 0

under (5.9) with X in the place of the inverse of P. An answer counts only where (5.9) holds with the inverse itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from design.errors import Infeasible
from design.historical_data.block_diagonal import (
    MARGIN,
    BlockDiagonalProof,
    diagonal_blocks,
    functional,
    largest_eigenvalue,
    proof_without_gains,
    solve_quietly,
)
from design.historical_data.information import Mask
from design.historical_data.lifted_loop import Array, DelayedPlant
from design.solvers import solver


def cone_complementarity(plant: DelayedPlant, mask: Mask, x0: Array, bound: float, *, iterations: int = 30) -> BlockDiagonalProof:
    """Return gains under a mask and a proof that they cost no more than a bound, from x(0) with a zero history.

    Args:
        plant: the plant; without gains it must meet the theorem, as the scheme starts there.
        mask: (phases, memory + 1, n) with memory <= tau.
        x0: (n,).
        bound: of the cost.
        iterations: at most so many semidefinite programmes.

    Raises:
        Infeasible: no step's answer meets (5.9) with the inverse of P; ``value`` is the bound.
    """
    cp = solver("cvxpy")

    compiler: Any = cp  # its re-exports have no types
    phases, columns, n = mask.shape
    p, tau = plant.B.shape[1], plant.memory
    P: Any = cp.Variable((n, n), symmetric=True)
    X: Any = cp.Variable((n, n), symmetric=True)
    Q: list[Any] = [cp.Variable((n, n), symmetric=True) for _ in range(tau)]
    K: list[list[Any]] = [[cp.Variable((p, n)) for _ in range(columns)] for _ in range(phases)]
    omega = diagonal_blocks([P - sum(Q) - plant.weight, *Q])
    rows: list[Any] = [compiler.bmat([[P, np.eye(n)], [np.eye(n), X]]) >> 0, x0 @ P @ x0 <= bound]
    for i in range(phases):
        open_loop = enumerate([plant.A, *plant.delayed])
        row = compiler.hstack([M + plant.B @ K[i][j] if j < columns else M for j, M in open_loop])
        block = compiler.bmat([[-X, row], [row.T, -omega]])
        rows.append(0.5 * (block + block.T) + MARGIN * np.eye(n * (tau + 2)) << 0)
        rows += [K[i][j][:, l] == 0 for j in range(columns) for l in range(n) if not mask[i, j, l]]
    of_X: Any = cp.Parameter((n, n), symmetric=True)
    of_P: Any = cp.Parameter((n, n), symmetric=True)
    problem = cp.Problem(cp.Minimize(compiler.trace(of_X @ X) + compiler.trace(of_P @ P)), rows)
    last = proof_without_gains(plant, x0)[0]
    of_X.value, of_P.value = last, np.linalg.inv(last)
    for _ in range(iterations):
        solve_quietly(problem)
        if P.value is None:
            break
        found, others = np.asarray(0.5 * (P.value + P.value.T)), np.array([q.value for q in Q])
        gains = np.array([[k.value for k in phase] for phase in K]) * mask[:, :, None, :]
        if largest_eigenvalue(plant, gains, found, others) < 0.0 < np.linalg.eigvalsh(found)[0]:
            return BlockDiagonalProof(found, others, gains, (functional(found, others, [x0]),))
        of_X.value, of_P.value = found, 0.5 * (X.value + X.value.T)
    raise Infeasible(f"cone complementarity found no proof of a cost of {bound:g}", value=bound)
