"""Second moments over a chain that is periodic, such as turns in an order beside what is random: by one class of modes.

With the modes in d classes, each followed by the next, the operator L carries families on one class to those on another, so that

    rho(L)^d = rho(L^d on the families of one class)

which has 1/d of the unknowns, and no d eigenvalues of equal size on a circle, which a Krylov method cannot tell apart. So has
the cost to go of one class; those of the others follow from it.
"""

from __future__ import annotations

from functools import partial
from math import gcd

import numpy as np
import numpy.typing as npt

from design.errors import NotStable
from design.jump_linear.long_computations import gmres, spectral_radius
from design.jump_linear.second_moment import (
    EIG_DENSE_AFTER,
    EIG_DENSE_LIMIT,
    largest_by_arpack,
    mean_square_radius,
    restarts_for,
    to_matrix,
    to_vector,
)
from design.jump_linear.stability_proof import side_of_one

Array = npt.NDArray[np.float64]


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


def periodic_radius(A: Array, transition: Array, *, bounded: bool = True) -> float:
    """Return what `mean_square_radius` does, sooner where the chain is periodic.

    A cycle without chance takes the eigenvalues of its product of matrices, and no second moments.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) row-stochastic matrix.
        bounded: as of `mean_square_radius`.
    """
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
    found = gmres(lambda vector: vector - _around(steps, n, vector), to_vector(once).ravel())
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
