r"""How fast a system grows at most whose modes follow each other in any order that a graph allows: no probabilities are known.

.. math:: x(k+1) = A_{i(k)} x(k), \qquad (i(k), i(k+1)) \in G

With any :math:`P_i > 0` let :math:`\rho_{ij}` be the least number with :math:`A_i' P_j A_i \le \rho_{ij} P_i`. Along every path
:math:`x' P x` is multiplied by at most the product of its :math:`\rho`, so that in the long run it grows per slot by at most
the largest geometric mean of :math:`\rho` over the cycles of G (Karp 1978). Below 1 the system is stable in every order.
The P are first those of a chain in which all that may follow is as likely, whose second moments grow by one factor everywhere;
where they prove nothing, those of a solver. Whatever P come out, the bound is computed from them, and holds.

Reference: Ahmadi, Jungers, Parrilo, Roozbehani, Joint spectral radius and path-complete graph Lyapunov functions, SIAM J. Control
Optim. 52 (2014), section 2; Karp, A characterization of the minimum cycle mean in a digraph, Discrete Mathematics 23 (1978).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import NotStable

Array = npt.NDArray[np.float64]

ASKED = 0.98
"""Growth below which the P of a chain are good enough, and which a solver is asked for."""
MOST_OF_SOLVER = 128
"""Modes for which a solver is asked."""
ROUNDS = 5000
SETTLED = 1e-12
FLOOR = 1e-4
"""Part of the identity that is added to every P: they stay positive definite where the largest growth does not reach."""


class EveryOrder(NamedTuple):
    """What holds in every order.

    Attributes:
        growth: a quadratic form of the state is multiplied by at most this per slot, in the long run.
        cycle: modes of the cycle that decides, in order.
        cycle_radius: what the state is multiplied by in one turn of that cycle, squared and per slot: a lower bound.
        solver: who found the P; empty for those of a chain, alike on every machine.
    """

    growth: float
    cycle: tuple[int, ...]
    cycle_radius: float
    solver: str


def growth_in_every_order(A: Array, follows: npt.NDArray[np.bool_]) -> EveryOrder:
    """Return how fast a system grows at most.

    Args:
        A: (N, n, n) mode matrices; x(k+1) = A_i x(k) in mode i.
        follows: (N, N) whether mode j may follow mode i; one at least follows each.

    Raises:
        NotStable: no family of P was found.

    >>> half = np.array([[[0.5]], [[0.8]]])
    >>> round(growth_in_every_order(half, np.array([[False, True], [True, False]])).growth, 6)
    0.4
    >>> round(growth_in_every_order(half, np.ones((2, 2), dtype=bool)).growth, 6)
    0.64
    """
    mean, cycle = _growth(A, follows, _of_chances(A, follows / follows.sum(axis=1, keepdims=True)))
    solver = ""
    if mean >= ASKED and len(A) <= MOST_OF_SOLVER and (P := _of_solver(A, follows, ASKED)) is not None:
        other = _growth(A, follows, P)
        mean, cycle, solver = (*other, "Clarabel") if other[0] < mean else (mean, cycle, solver)
    turned = np.eye(A.shape[-1])
    for i in cycle:
        turned = A[i] @ turned
    radius = float(np.abs(np.linalg.eigvals(turned)).max()) ** (2.0 / len(cycle))
    return EveryOrder(mean, cycle, radius, solver)


def _growth(A: Array, follows: npt.NDArray[np.bool_], P: Array) -> tuple[float, tuple[int, ...]]:
    """The largest geometric mean of rho over the cycles, and the cycle."""
    weights = np.full(follows.shape, -np.inf)
    for i, j in np.argwhere(follows):
        weights[i, j] = np.log(max(_factor(A[i], P[i], P[j]), 1e-300))
    mean, cycle = _largest_cycle_mean(weights)
    return float(np.exp(mean)), cycle


def _of_chances(A: Array, chances: Array) -> Array:
    """P of the chain: what its second moments give again, up to a factor, with a part of the identity."""
    identity = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    P, turned = np.array(identity), A.transpose(0, 2, 1)
    for _ in range(ROUNDS):
        after = turned @ np.einsum("ij,jab->iab", chances, P) @ A
        largest = np.abs(after).max()
        if not np.isfinite(largest):
            raise NotStable("no quadratic form was found: the numbers of the loop are too large")
        after = (after / largest if largest > 0.0 else after) + FLOOR * identity
        settled, P = np.abs(after - P).max() <= SETTLED, after
        if settled:
            break
    return P


def _of_solver(A: Array, follows: npt.NDArray[np.bool_], growth: float) -> Array | None:
    """P with A_i' P_j A_i < growth P_i wherever j may follow i, as a solver finds them; None where it finds none."""
    from design.lmi.program import LmiProgram

    program, identity = LmiProgram(), np.eye(A.shape[-1])
    for i in range(len(A)):
        program.symmetric(f"P{i}", A.shape[-1])
        program.require(f"P{i} > I", lambda P: identity - P, f"P{i}", strict=False)
    for i, j in np.argwhere(follows).tolist():
        if i == j:
            program.require(f"{i} to {j}", lambda P, own=A[i]: own.T @ P @ own - growth * P, f"P{i}")
        else:
            program.require(f"{i} to {j}", lambda P, Q, own=A[i]: own.T @ Q @ own - growth * P, f"P{i}", f"P{j}")
    found = program.solve().matrices
    P = np.array([found[f"P{i}"] for i in range(len(A))])
    return P if np.isfinite(P).all() and np.linalg.eigvalsh(P)[:, 0].min() > 0.0 else None


def _factor(A: Array, P: Array, following: Array) -> float:
    """The least rho with A' P_j A <= rho P_i, taken anew from the Cholesky factors and rounded up."""
    lower, upper = np.linalg.cholesky(P), np.linalg.cholesky(following)
    moved = np.linalg.solve(lower, A.T @ upper)
    return float(np.linalg.norm(moved, 2)) ** 2 * (1.0 + 1e-9)


def _largest_cycle_mean(weights: Array) -> tuple[float, tuple[int, ...]]:
    """The largest mean weight of a cycle, and the cycle; -inf is no edge."""
    N = len(weights)
    best = np.zeros((N + 1, N))
    came = np.zeros((N + 1, N), dtype=np.int64)
    for k in range(N):  # from anywhere
        through = best[k][:, None] + weights
        came[k + 1], best[k + 1] = through.argmax(axis=0), through.max(axis=0)
    ends = np.isfinite(best[N])
    with np.errstate(invalid="ignore"):
        means = np.where(np.isfinite(best[:N]), (best[N] - best[:N]) / (N - np.arange(N))[:, None], np.inf).min(axis=0)
    at = int(np.where(ends, means, -np.inf).argmax())
    path = [at]
    for k in range(N, 0, -1):
        path.append(int(came[k, path[-1]]))
    path.reverse()
    cycles = [path[i:j] for i in range(len(path)) for j in range(i + 1, len(path)) if path[i] == path[j]]
    sums = [(sum(weights[a, b] for a, b in zip(c, [*c[1:], c[0]])) / len(c), tuple(c)) for c in cycles]
    mean, cycle = max(sums, key=lambda each: each[0])
    return max(float(mean), float(means[at])), cycle
