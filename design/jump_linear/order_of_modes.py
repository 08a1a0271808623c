"""Loops whose modes follow each other in turns, or in any order that a graph allows.

In turns: second moments over a chain that is periodic, such as turns in an order beside what is random, by one class of modes.
With the modes in d classes, each followed by the next, the operator L carries families on one class to those on another, so that

    rho(L)^d = rho(L^d on the families of one class)

which has 1/d of the unknowns, and no d eigenvalues of equal size on a circle, which a Krylov method cannot tell apart. So has
the cost to go of one class; those of the others follow from it. Modes that do not lead to each other, as two cycles side by side
in each of their phases, are taken apart first: the radius is the largest of theirs.

In any order: how fast a system grows at most, where no probabilities are known,

    x(k+1) = A_i(k) x(k),    (i(k), i(k+1)) in G

With any P_i > 0 let rho_ij be the least number with A_i' P_j A_i <= rho_ij P_i. Along every path x' P x is multiplied by at most
the product of its rho, so that in the long run it grows per slot by at most the largest geometric mean of rho over the cycles of
G (Karp 1978). Below 1 the system is stable in every order. The P are first those of a chain in which all that may follow is as
likely, whose second moments grow by one factor everywhere; where they prove nothing, those of a solver. Whatever P come out, the
bound is computed from them, and holds.

Reference: Ahmadi, Jungers, Parrilo, Roozbehani, Joint spectral radius and path-complete graph Lyapunov functions, SIAM J. Control
Optim. 52 (2014), section 2; Karp, A characterization of the minimum cycle mean in a digraph, Discrete Mathematics 23 (1978).
"""

from __future__ import annotations

from functools import partial
from math import gcd
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import NotStable
from design.jump_linear.long_computations import PRODUCTS, gmres, spectral_radius
from design.jump_linear.second_moment import (
    EIG_DENSE_AFTER,
    EIG_DENSE_LIMIT,
    Array,
    largest_by_arpack,
    mean_square_radius,
    restarts_for,
    to_matrix,
    to_vector,
)
from design.jump_linear.stability_proof import side_of_one


def strong_classes(transition: Array) -> list[npt.NDArray[np.intp]]:
    """Return the modes in classes of those that lead to each other, whether the chain leaves them or not.

    >>> [each.tolist() for each in strong_classes(np.array([[0.5, 0.5, 0], [0, 0, 1], [0, 1, 0]]))]
    [[0], [1, 2]]
    """
    follows, found, left = transition > 0.0, [], np.ones(len(transition), dtype=np.bool_)
    while left.any():
        one = np.arange(len(left)) == left.argmax()
        own = led_to(follows, one) & led_to(follows.T, one)
        found.append(np.flatnonzero(own))
        left &= ~own
    return found


def led_to(follows: npt.NDArray[np.bool_], begins: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return to which modes some modes lead, themselves among them, (N,).

    Args:
        follows: (N, N) which mode may follow which.
        begins: (N,) from which modes on.
    """
    found = ahead = begins
    while ahead.any():
        ahead = follows[ahead].any(axis=0) & ~found
        found = found | ahead
    return found


def cyclic_classes(transition: Array) -> list[npt.NDArray[np.intp]]:
    """Return the modes in classes of which each is followed by the next, as many as there can be; one for an aperiodic chain.

    Args:
        transition: (N, N) row-stochastic matrix; all modes in one class if some cannot be reached from mode 0.

    >>> [each.tolist() for each in cyclic_classes(np.array([[0, 0.5, 0.5], [1, 0, 0], [1, 0, 0]]))]
    [[0], [1, 2]]
    """
    level, edges = np.full(len(transition), -1), transition > 0.0
    level[0], front = 0, np.zeros(1, dtype=np.intp)
    while len(front):
        ahead = np.flatnonzero(edges[front].any(axis=0) & (level < 0))
        level[ahead], front = level[front[0]] + 1, ahead
    if (level < 0).any():
        return [np.arange(len(transition))]
    i, j = np.nonzero(edges)
    period = gcd(*np.abs(level[i] + 1 - level[j]).tolist())
    return [np.flatnonzero(level % period == c) for c in range(period)]


def parts(A: Array, transition: Array) -> list[tuple[Array, Array]]:
    """Return the matrices and transitions of every class of modes that lead to each other; a small system is taken whole.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) transition probabilities.
    """
    if len(A) * A.shape[-1] * (A.shape[-1] + 1) // 2 <= EIG_DENSE_LIMIT:
        return [(A, transition)]
    from scipy.sparse.csgraph import connected_components  # larger systems load scipy.sparse anyway

    count, of = connected_components(transition > 0.0, connection="strong")
    own = [np.flatnonzero(of == each) for each in range(count)]
    inner = [(A[each], transition[np.ix_(each, each)]) for each in own] if count > 1 else [(A, transition)]
    return [(matrices, chances) for matrices, chances in inner if chances.any()]


def periodic_radius(A: Array, transition: Array, *, bounded: bool = True) -> float:
    """Return what `mean_square_radius` does, sooner where the chain is periodic, or falls into parts.

    A cycle without chance takes the eigenvalues of its product of matrices, and no second moments.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) row-stochastic matrix.
        bounded: as of `mean_square_radius`.
    """
    found = [_radius(*each, bounded) for each in parts(A, transition)]
    return max(found, key=lambda radius: (radius >= 1.0, radius != radius, radius), default=0.0)  # unknown, unless one decides


def _radius(A: Array, transition: Array, bounded: bool) -> float:
    n = A.shape[-1]
    classes = cyclic_classes(transition)
    first, size = classes[0], len(classes[0]) * n * (n + 1) // 2
    if len(classes) == 1:
        return mean_square_radius(A, transition, bounded=bounded)
    if len(classes) == len(A):
        return _product_radius([A[each[0]] for each in classes])
    product, found = partial(_around, _steps(A, transition, classes), n), None
    if size > EIG_DENSE_LIMIT:
        start = to_vector(np.broadcast_to(np.eye(n), (len(first), n, n))).ravel()
        found = largest_by_arpack(product, start, restarts_for(size * len(classes)), 2, 20)
    if found is None:
        if size > EIG_DENSE_AFTER:
            return side_of_one(A, transition).bound if bounded else float("nan")
        found = spectral_radius(np.column_stack([product(column) for column in np.eye(size)]))
    return float(found ** (1.0 / len(classes)))


def _product_radius(matrices: list[Array]) -> float:
    """Radius of X -> A X A' once round, per step."""
    product, grown = np.eye(len(matrices[0])), 0.0
    for each in matrices:
        product = each @ product
        size = float(np.abs(product).max())
        if not 0.0 < size < np.inf:
            return size
        product, grown = product / size, grown + np.log(size)
    radius = float(np.abs(np.linalg.eigvals(product)).max())
    return float(np.exp(2.0 * (grown + np.log(radius)) / len(matrices))) if radius > 0.0 else 0.0


def periodic_cost(A: Array, transition: Array, Q: Array) -> Array:
    """Return S with S_i = Q_i + A_i' E_i(S) A_i, where the radius is known to be below 1.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) row-stochastic matrix.
        Q: (N, n, n), symmetric.

    Raises:
        NotStable: the radius is so near 1 that S was not found.
    """
    n, classes = A.shape[-1], cyclic_classes(transition)
    steps, S = _steps(A, transition, classes), np.zeros_like(Q)
    once = _back(steps, [Q[now] for now in classes], np.zeros_like(Q[classes[0]]))[0]
    found = gmres(lambda vector: vector - _around(steps, n, vector), to_vector(once).ravel(), products=10 * PRODUCTS)
    if found is None:
        raise NotStable("the cost was not found: the loop is too near to one that is not mean-square stable")
    each = _back(steps, [Q[now] for now in classes], to_matrix(found.reshape(len(classes[0]), -1), n))
    for now, part in zip(classes, each):
        S[now] = part
    return S


_Steps = list[tuple[Array, Array]]


def _steps(A: Array, transition: Array, classes: list[npt.NDArray[np.intp]]) -> _Steps:
    return [(A[now], transition[np.ix_(now, later)]) for now, later in zip(classes, [*classes[1:], classes[0]])]


def _around(steps: _Steps, n: int, vector: Array) -> Array:
    """L^d on the families of the first class, in coordinates."""
    S = to_matrix(vector.reshape(len(steps[0][0]), -1), n)
    for matrices, chances in reversed(steps):
        S = matrices.transpose(0, 2, 1) @ np.tensordot(chances, S, axes=1) @ matrices
    return to_vector(S).ravel()


def _back(steps: _Steps, Q: list[Array], S: Array) -> list[Array]:
    """The cost to go of every class, from that of the first class once round."""
    found = []
    for (matrices, chances), cost in zip(reversed(steps), reversed(Q)):
        S = cost + matrices.transpose(0, 2, 1) @ np.tensordot(chances, S, axes=1) @ matrices
        found.append(S)
    return found[::-1]


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

    program = LmiProgram()
    for i in range(len(A)):
        program.symmetric(f"P{i}", A.shape[-1], least=1.0)
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
