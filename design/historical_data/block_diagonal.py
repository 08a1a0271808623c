r"""Theorem 5.1 with its functional put right: what it proves, and two schemes that find gains by it.

.. math:: V = x^T P x + \sum_{j=1}^{\tau} \sum_{h=-j}^{-1} x(k+h)^T Q_j x(k+h)

proves J < V(0) if, for every phase i,

.. math:: \begin{bmatrix} -P^{-1} & \bar A_c(i) \\ \bar A_c(i)^T & -\Omega \end{bmatrix} < 0,
    \qquad \Omega = \mathrm{diag}(P - \textstyle\sum_j Q_j - \Xi, Q_1, \dots, Q_\tau)

For gains that are given, `common_bound` seeks one matrix on the whole stacked state, whichever node sends next.

`tangent_scheme` never leaves its feasible set; `cone_complementarity` is the thesis's own scheme, with every answer checked.

DEVIATION: the printed functional sums h from j - tau - 1, which pairs Q_j with the lag tau + 1 - j (ERRATA).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from design.errors import Infeasible, solver
from design.historical_data import Array, DelayedPlant, LiftedLoop
from design.historical_data.sensor_schedule import Mask

MARGIN = 1e-6


class BlockDiagonalProof(NamedTuple):
    """P, Q_1 ... Q_tau, the gains that they prove, and the bound of the cost after each iteration."""

    P: Array
    Q: Array
    gains: Array
    bounds: tuple[float, ...]


def functional(P: Array, Q: Array, history: Sequence[Array]) -> float:
    """Return V(0), the bound of the cost.

    Args:
        P: (n, n).
        Q: (tau, n, n).
        history: x(0), x(-1), ...; what is not given is zero.
    """
    x = [np.asarray(each, dtype=float) for each in history]
    past = sum(x[h] @ Q[j - 1] @ x[h] for j in range(1, len(Q) + 1) for h in range(1, min(j + 1, len(x))))
    return float(x[0] @ P @ x[0] + past)


def largest_eigenvalue(plant: DelayedPlant, gains: Array, P: Array, Q: Array) -> float:
    """Return the largest eigenvalue of (5.9) with X = P^-1 over all phases; below 0 the bound is proved."""
    n, tau = len(P), len(Q)
    size = n * (tau + 1)
    omega = np.zeros((size, size))
    omega[:n, :n] = P - Q.sum(axis=0) - plant.weight
    for j in range(tau):
        at = slice(n * (j + 1), n * (j + 2))
        omega[at, at] = Q[j]
    open_loop = np.concatenate([plant.A[None], plant.delayed])
    worst = -np.inf
    for K in gains:
        closed = open_loop.copy()
        closed[: len(K)] += np.einsum("np,jpm->jnm", plant.B, K)
        row = np.concatenate(list(closed), axis=1)
        block = np.block([[-np.linalg.inv(P), row], [row.T, -omega]])
        worst = max(worst, float(np.linalg.eigvalsh(block)[-1]))
    return worst


def tangent_scheme(plant: DelayedPlant, mask: Mask, x0: Array, *, iterations: int = 8) -> BlockDiagonalProof:
    """Return gains under a mask and a proof of their cost by the corrected Theorem 5.1, from x(0) with a zero history.

    P^{-1} >= 2 X - X P X for every X, so that the inequality with 2 X - X P X in its place is sufficient, and convex in (P, Q,
    K). With X the inverse of the last P every iterate is feasible and the bound falls.

    Args:
        plant: the plant; without gains it must meet the theorem, as the scheme starts there.
        mask: (phases, memory + 1, n) with memory <= tau.
        x0: (n,).
        iterations: at most so many semidefinite programmes.

    Raises:
        Infeasible: the theorem's conditions cannot be met without gains, or a step's answer fails its own check.
    """
    phases, columns, n = mask.shape
    p = plant.B.shape[1]
    K = np.zeros((phases, columns, p, n))
    P, Q = proof_without_gains(plant, x0)
    bounds = [functional(P, Q, [x0])]
    for _ in range(iterations):
        step = _tangent_step(plant, mask, x0, np.asarray(np.linalg.inv(P), dtype=np.float64))
        if step is None:
            break
        bound = functional(step[0], step[1], [x0])
        if largest_eigenvalue(plant, step[2], step[0], step[1]) >= 0.0 or bound >= bounds[-1]:
            break
        P, Q, K = step
        bounds.append(bound)
        if bounds[-2] - bounds[-1] < 1e-4 * bounds[-1]:
            break
    return BlockDiagonalProof(P, Q, K, tuple(bounds))


def proof_without_gains(plant: DelayedPlant, x0: Array) -> tuple[Array, Array]:
    """Return P, (n, n), and Q, (tau, n, n), of least V(0) at K = 0, where (5.9) multiplied out is linear.

    Raises:
        Infeasible: the theorem cannot be met without gains.
    """
    cp = solver("cvxpy")

    n, tau = len(plant.A), plant.memory
    P: Any = cp.Variable((n, n), symmetric=True)
    Q: list[Any] = [cp.Variable((n, n), symmetric=True) for _ in range(tau)]
    row = np.concatenate([plant.A, *plant.delayed], axis=1)
    omega = diagonal_blocks([P - sum(Q) - plant.weight, *Q])
    rows = [row.T @ P @ row - omega + MARGIN * np.eye(n * (tau + 1)) << 0, P >> MARGIN * np.eye(n)]
    solve_quietly(cp.Problem(cp.Minimize(x0 @ P @ x0), rows))
    if P.value is None:
        raise Infeasible("Theorem 5.1 cannot be met without gains: the tangent scheme has nowhere to start")
    found = np.asarray(P.value), np.array([q.value for q in Q])
    worst = largest_eigenvalue(plant, np.zeros((1, 1, plant.B.shape[1], n)), *found)
    if worst >= 0.0:
        raise Infeasible("Theorem 5.1 cannot be met without gains: the tangent scheme has nowhere to start", value=worst)
    return found


class _Programme:
    """P, Q and K as unknowns, K under a mask."""

    def __init__(self, plant: DelayedPlant, mask: Mask) -> None:
        cp = solver("cvxpy")
        (phases, columns, n), p = mask.shape, plant.B.shape[1]
        self._plant, self._mask = plant, mask
        self.P: Any = cp.Variable((n, n), symmetric=True)
        self.Q: list[Any] = [cp.Variable((n, n), symmetric=True) for _ in range(plant.memory)]
        self._K: list[list[Any]] = [[cp.Variable((p, n)) for _ in range(columns)] for _ in range(phases)]

    def rows(self, inverse: Any) -> list[Any]:
        """Return (5.9) in every phase with ``inverse`` in the place of that of P, and that no gain is where the mask has none."""
        cp = solver("cvxpy")
        plant, mask, found = self._plant, self._mask, []
        omega = diagonal_blocks([self.P - sum(self.Q) - plant.weight, *self.Q])
        for gains, known in zip(self._K, mask):
            closed = [M + plant.B @ gains[j] if j < len(known) else M for j, M in enumerate([plant.A, *plant.delayed])]
            row = cp.hstack(closed)
            block = cp.bmat([[-inverse, row], [row.T, -omega]])
            found.append(0.5 * (block + block.T) + MARGIN * np.eye(mask.shape[2] * (plant.memory + 2)) << 0)
            found += [gains[j][:, l] == 0 for j, l in np.argwhere(~known).tolist()]
        return found

    def answer(self) -> tuple[Array, Array, Array]:
        """Return what was found of P, Q and K."""
        gains = np.array([[k.value for k in phase] for phase in self._K]) * self._mask[:, :, None, :]
        return np.asarray(self.P.value), np.array([q.value for q in self.Q]), gains


def _tangent_step(plant: DelayedPlant, mask: Mask, x0: Array, X: Array) -> tuple[Array, Array, Array] | None:
    cp, programme = solver("cvxpy"), _Programme(plant, mask)
    P = programme.P
    rows = [P >> MARGIN * np.eye(len(X)), *programme.rows(2 * X - X @ P @ X)]
    solve_quietly(cp.Problem(cp.Minimize(x0 @ P @ x0), rows))
    return None if P.value is None else programme.answer()


def diagonal_blocks(blocks: list[Any]) -> Any:
    """Return the block-diagonal matrix of square blocks of one size."""
    n = blocks[0].shape[0]
    zero = np.zeros((n, n))
    return solver("cvxpy").bmat([[block if i == j else zero for j in range(len(blocks))] for i, block in enumerate(blocks)])


def solve_quietly(problem: Any) -> None:
    """Solve a semidefinite programme; where the solver fails its variables have no values."""
    cp = solver("cvxpy")

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # whatever the solver says of its answer, the caller checks it
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.error.SolverError:
            pass


def cone_complementarity(plant: DelayedPlant, mask: Mask, x0: Array, bound: float, *, iterations: int = 30) -> BlockDiagonalProof:
    r"""Return gains under a mask and a proof that they cost no more than a bound, from x(0) with a zero history.

    It solves

    .. math:: \min \operatorname{tr}(P_k X + X_k P), \qquad \begin{bmatrix} P & I \\ I & X \end{bmatrix} \ge 0

    under (5.9) with X in the place of the inverse of P. An answer counts only where (5.9) holds with the inverse itself.

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
    programme, n = _Programme(plant, mask), mask.shape[2]
    P = programme.P
    X, of_X, of_P = (make((n, n), symmetric=True) for make in (cp.Variable, cp.Parameter, cp.Parameter))
    rows = [cp.bmat([[P, np.eye(n)], [np.eye(n), X]]) >> 0, x0 @ P @ x0 <= bound, *programme.rows(X)]
    problem = cp.Problem(cp.Minimize(cp.trace(of_X @ X) + cp.trace(of_P @ P)), rows)
    last = proof_without_gains(plant, x0)[0]
    of_X.value, of_P.value = last, np.linalg.inv(last)
    for _ in range(iterations):
        solve_quietly(problem)
        if P.value is None:
            break
        found, others, gains = programme.answer()
        found = 0.5 * (found + found.T)
        if largest_eigenvalue(plant, gains, found, others) < 0.0 < np.linalg.eigvalsh(found)[0]:
            return BlockDiagonalProof(found, others, gains, (functional(found, others, [x0]),))
        of_X.value, of_P.value = found, X.value
    raise Infeasible(f"cone complementarity found no proof of a cost of {bound:g}", value=bound)


MARGINS = (1e-6, 1e-5, 1e-4, 1e-3)
"""By how much the inequalities are asked to hold, as a share of the largest weight: a solver's rounding cannot break them."""


def common_bound(loop: LiftedLoop, X0: Array) -> tuple[float, Array]:
    """Return the least X0' P X0 with P > 0 and L_i' P L_i - P + Q_i <= 0 for every phase i, and P.

    One P for every order of the sensors: stability and a bound of the cost, whichever node sends next.

    The inequalities are asked for with a margin and evaluated at the returned matrix: the bound holds for that matrix.

    Args:
        loop: the lifted loop; its chain is not used.
        X0: (N,), the stacked state in slot 0.

    Raises:
        Infeasible: no such P was found; ``value`` is the largest eigenvalue that stays.
    """
    cp = solver("cvxpy")

    size, scale = loop.L.shape[-1], float(np.abs(loop.Q).max())
    worst = np.inf
    for margin in MARGINS:
        P: Any = cp.Variable((size, size), symmetric=True)
        rows = [L.T @ P @ L - P + Q / scale + margin * np.eye(size) << 0 for L, Q in zip(loop.L, loop.Q)]
        problem: Any = cp.Problem(cp.Minimize(X0 @ P @ X0), rows)
        solve_quietly(problem)
        if P.value is None:
            raise Infeasible(f"no common Lyapunov matrix was found: the solver says {problem.status}")
        found = scale * np.asarray(0.5 * (P.value + P.value.T))
        gaps = loop.L.transpose(0, 2, 1) @ found @ loop.L - found + loop.Q
        worst = float(np.linalg.eigvalsh(0.5 * (gaps + gaps.transpose(0, 2, 1))).max())
        if worst <= 0.0 < float(np.linalg.eigvalsh(found)[0]):
            return float(X0 @ found @ X0), found
    raise Infeasible("the Lyapunov matrix of the solver does not satisfy the inequalities", value=worst)
