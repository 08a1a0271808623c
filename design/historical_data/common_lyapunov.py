"""One Lyapunov matrix for every order of the sensors: stability and a bound of the cost whoever sends next."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from design.errors import Infeasible
from design.historical_data.lifted_loop import Array, LiftedLoop
from design.solvers import solver

MARGINS = (1e-6, 1e-5, 1e-4, 1e-3)
"""By how much the inequalities are asked to hold, as a share of the largest weight: a solver's rounding cannot break them."""


def common_bound(loop: LiftedLoop, X0: Array) -> tuple[float, Array]:
    """Return the least X0' P X0 with P > 0 and L_i' P L_i - P + Q_i <= 0 for every phase i, and P.

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
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what the solver returns is checked below, whatever it says of it
            problem.solve(solver=cp.CLARABEL)
        if P.value is None:
            raise Infeasible(f"no common Lyapunov matrix was found: the solver says {problem.status}")
        found = scale * np.asarray(0.5 * (P.value + P.value.T))
        gaps = loop.L.transpose(0, 2, 1) @ found @ loop.L - found + loop.Q
        worst = float(np.linalg.eigvalsh(0.5 * (gaps + gaps.transpose(0, 2, 1))).max())
        if worst <= 0.0 < float(np.linalg.eigvalsh(found)[0]):
            return float(X0 @ found @ X0), found
    raise Infeasible("the Lyapunov matrix of the solver does not satisfy the inequalities", value=worst)
