"""The thesis's route: linear matrix inequalities iterated to meet the nonconvex constraint, for comparison.

Theorem 7.3 and 7.5 ask for P_i > 0 and X_i = (sum_j p_ij P_j)^-1 with linear matrix inequalities in P, X and K. Cone
complementarity (the product reduction algorithm, PRA) relaxes the inverse to

    [E_i(P)  I; I  X_i] >= 0

and lowers sum_i tr(E_i(P) X_i), linearised at the last iterate, until X_i E_i(P) = I closely enough. Here an iterate
is accepted as soon as its *gains* meet the level, by the exact norm of their loop; the level then falls to that norm
less a share, and the search ends when an iteration budget does.

DEVIATION: (7.24c) sums over r where j is meant; E_i(P) is the conditional expectation (7.29).

References: Theorems 7.3, 7.5, (7.26), (7.31); El Ghaoui, Oustry and AitRami, IEEE TAC 42(8), 1997.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from design.errors import DesignError, solver
from design.jump_linear.bounded_real import solve_bounded_real
from design.jump_linear.second_moment import Resolvent, expect
from design.processes.delay_chain import Array
from design.tracking import TrackingProblem
from design.tracking.loop_objective import LoopObjective, check_plant, stabilising
from design.tracking.synthesis import Design, Progress, certified

STEP = 0.02  # the level asked for lies this share below the last norm that was reached
PATIENCE = 12  # linear programmes per level


class CclResult(NamedTuple):
    """Gains, their exact norm, the number of semidefinite programmes solved, and (programme, norm) as it fell."""

    gains: Array
    level: float
    iterations: int
    history: tuple[tuple[int, float], ...]


def design_by_ccl(problem: TrackingProblem, *, progress: Progress | None = None) -> Design:
    """A design whose gains are those of ``solve_ccl``, with everything that is known of it computed from them.

    Raises:
        NotStable: the gains have no certificate.
        DesignError: an objective or option that this route has not.
    """
    from design.whole_process import one_blas_thread

    with one_blas_thread():
        check_plant(*(np.asarray(M, dtype=np.float64) for M in (problem.A, problem.B, problem.C)))
        found = solve_ccl(problem, progress=progress)
        return certified(problem, found.gains, starts=(found.level,), evaluations=found.iterations)


def solve_ccl(problem: TrackingProblem, *, iterations: int = 60, progress: Progress | None = None) -> CclResult:
    """Cone complementarity for an H2 or H-infinity problem without gain bound.

    Args:
        problem: what is asked; objective "h2" or "hinf".
        iterations: budget of semidefinite programmes.

    Raises:
        DesignError: an objective or option that this route has not.
    """
    if problem.objective == "mixed" or problem.gain_bound is not None:
        raise DesignError("method: ccl solves h2 and hinf problems without a gain bound; take method 'direct'")
    structure, space = problem.structure(), problem.space()
    objective = LoopObjective(structure, space, problem.alpha(structure))
    v = stabilising(objective, space.coordinates(np.zeros(space.shape)))
    norm = objective.h2 if problem.objective == "h2" else objective.hinf
    reached, best = norm(v)[0], v
    programme = _Programme(problem, space.gains(best), reached)
    P, X = programme.start(space.gains(best), reached)
    history = [(0, reached)]
    level, waited = reached * (1.0 - STEP), 0
    for iteration in range(1, iterations + 1):
        step = programme.solve(P, X, level)
        value = np.inf
        if step is not None:
            P, X, free = step
            value = norm(free)[0]
            if value < reached:
                reached, best, waited = value, free, 0
                history.append((iteration, reached))
        if value <= level:
            level = reached * (1.0 - STEP)
            P, X = programme.start(space.gains(best), reached)
        waited += 1
        if step is None or waited > PATIENCE:  # not met at this level: ask for less of a step
            level, waited = 0.5 * (level + reached), 0
            P, X = programme.start(space.gains(best), reached)
            if reached / level - 1.0 < 1e-4:
                break
        if progress is not None:
            progress("ccl", iteration, iterations, reached)
    return CclResult(space.gains(best), reached, iteration, tuple(history))


class _Programme:
    """One linearised programme as a parametrised cvxpy problem, compiled once.

    z is divided by the first norm and the state transformed so that the first P is about I: without that the solver's
    tolerances mean nothing (as they did not for Chapters 2 to 4) and it stops at once on the VTOL.
    """

    def __init__(self, problem: TrackingProblem, gains: Array, norm: float) -> None:
        cp = solver("cvxpy")
        self.structure, self.space, self.norm = problem.structure(), problem.space(), norm
        s = self.structure
        N, n, q = s.B.shape
        self.h2 = problem.objective == "h2"
        self.root = np.eye(n)
        raw = self.start(gains, norm)[0]
        root = np.diag(np.sqrt(np.diagonal(np.mean(raw, axis=0))))
        self.root, inverse = root, np.linalg.inv(root)
        bases = root.T @ s.base @ inverse.T
        B, C = root.T @ s.B, s.C @ inverse.T / norm
        # the gains' effect is affine: matrices of the basis vectors, once
        basis = [root.T @ (s.matrices(self.space.gains(e)) - s.base) @ inverse.T for e in np.eye(self.space.size)]
        self.unit = cp.Parameter(nonneg=True, name="square level")
        self.free = cp.Variable(self.space.size)
        self.P = [cp.Variable((n, n), symmetric=True) for _ in range(N)]
        self.X = [cp.Variable((n, n), symmetric=True) for _ in range(N)]
        self.P0 = [cp.Parameter((n, n), symmetric=True) for _ in range(N)]
        self.X0 = [cp.Parameter((n, n), symmetric=True) for _ in range(N)]
        E = [sum(s.transition[i, j] * self.P[j] for j in range(N) if s.transition[i, j] > 0) for i in range(N)]
        constraints: list[Any] = []
        cost: Any = 0
        eye = np.eye(n)
        alpha = problem.alpha(s)
        for i in range(N):
            A = bases[i] + sum(self.free[e] * basis[e][i] for e in range(self.space.size) if basis[e][i].any())
            rows = C[i].shape[0]
            if self.h2:
                block = cp.bmat([[-self.P[i], A.T, C[i].T], [A, -self.X[i], np.zeros((n, rows))],
                                 [C[i], np.zeros((rows, n)), -np.eye(rows)]])  # fmt: skip
            else:
                block = cp.bmat([
                    [-self.P[i], np.zeros((n, q)), C[i].T, A.T],
                    [np.zeros((q, n)), -self.unit * np.eye(q), np.zeros((q, rows)), B[i].T],
                    [C[i], np.zeros((rows, q)), -np.eye(rows), np.zeros((rows, n))],
                    [A, B[i], np.zeros((n, rows)), -self.X[i]],
                ])  # fmt: skip
            constraints += [block << 0, cp.bmat([[E[i], eye], [eye, self.X[i]]]) >> 0]
            cost = cost + cp.trace(self.X0[i] @ E[i]) + cp.trace(self.P0[i] @ self.X[i])
        if self.h2:
            energy = sum(alpha[i] * cp.trace(B[i].T @ E[i] @ B[i]) for i in range(N))
            constraints.append(energy <= self.unit)
        self.cvx = cp.Problem(cp.Minimize(cost), constraints)

    def start(self, gains: Array, norm: float) -> tuple[list[Array], list[Array]]:
        """E_i(P) and its inverse for stable gains, at a level a little above their norm."""
        s = self.structure
        A = s.matrices(gains)
        C2 = s.C.transpose(0, 2, 1) @ s.C
        small = 1e-6 * np.abs(C2).max() * np.eye(A.shape[-1])
        if self.h2:
            P = Resolvent(A, s.transition).cost(C2 + small)
        else:
            zero = np.zeros((A.shape[0], s.C.shape[1], s.B.shape[2]))
            policy = solve_bounded_real((A, s.B, s.C, zero, s.transition), (1.01 * norm) ** 2, float(small[0, 0]))
            P = policy.P if policy is not None else Resolvent(A, s.transition).cost(C2 + small)
        inverse = np.linalg.inv(self.root)
        E = inverse @ expect(s.transition, P / self.norm**2) @ inverse.T
        return list(E), [np.linalg.inv(e) for e in E]

    def solve(self, P: list[Array], X: list[Array], level: float) -> tuple[list[Array], list[Array], Array] | None:
        """Next E_i(P), X_i and free gains, None if the solver has none."""
        import warnings

        cp = solver("cvxpy")

        self.unit.value = (level / self.norm) ** 2
        for parameter, value in zip(self.P0 + self.X0, P + X, strict=True):
            parameter.value = 0.5 * (value + value.T)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # an inaccurate iterate is judged by the exact norm of its gains
                self.cvx.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return None
        if self.free.value is None or not np.isfinite(self.free.value).all():
            return None
        E = expect(self.structure.transition, np.stack([np.asarray(p.value) for p in self.P]))
        return list(E), [np.asarray(x.value) for x in self.X], np.asarray(self.free.value)
