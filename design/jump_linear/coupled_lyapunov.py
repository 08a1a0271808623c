"""Coupled Lyapunov equations over many modes, matrix-free.

    Y = W (M Y M') + G

M_i = A_i and W = P' give the covariance; M_i = A_i' and W = P the expected cost-to-go E_i(S), with G_i = E_i(Q).

A loop over a network is a plant of few states behind shift registers, and the moments among delayed signals follow from those
with the plant. Take a set F of states without which no state acts back on itself, such as the plant's own. The others have a
level: 1 + that of the highest that acts on them. An entry (r, r') outside F then needs entries of lower level only, so all of
them follow from the rows in F, level by level, and these rows alone are unknown: 93 numbers a mode for 1128 where both delays
reach 8.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.jump_linear.long_computations import gmres

Index = npt.NDArray[np.intp]
Levels = tuple[tuple[int, int], ...]

BORDERED_TOLERANCE = 1e-10
"""Of GMRES on a bordered equation: Newton's method on the fold corrects what it leaves."""
LIMIT = 6000
"""Unknowns from which on elimination pays: the vectors of GMRES get shorter, its products take no less time."""


class Plan(NamedTuple):
    """Order of the states, those of F first, and where every level starts and ends in it."""

    order: Index
    free: int
    levels: Levels


def plan_of(M: Array) -> Plan:
    """Return the plan of mode matrices (N, n, n), from where all of them are zero; F is every state where little is to gain."""
    modes, n, _ = M.shape
    if modes * n * (n + 1) // 2 >= LIMIT:
        plan = _plan((M != 0.0).any(axis=0).tobytes(), n)
        if 2 * plan.free <= n:
            return plan
    return Plan(np.arange(n), n, ())


@lru_cache(maxsize=64)
def _plan(pattern: bytes, n: int) -> Plan:
    acts = np.frombuffer(pattern, dtype=bool).reshape(n, n)
    free = sorted(_feedback_states(acts))
    rest = [r for r in range(n) if r not in free]
    level = dict.fromkeys(free, 0)
    sources = {r: [int(c) for c in np.flatnonzero(acts[r])] for r in rest}
    while len(level) < n:
        level |= {
            r: 1 + max((level[c] for c in sources[r]), default=0)
            for r in rest if r not in level and all(c in level for c in sources[r])
        }  # fmt: skip
    rest.sort(key=lambda r: (level[r], r))
    starts = [i + len(free) for i in range(len(rest)) if i == 0 or level[rest[i]] != level[rest[i - 1]]]
    return Plan(np.array([*free, *rest], dtype=np.intp), len(free), tuple(zip(starts, [*starts[1:], n])))


def _feedback_states(acts: npt.NDArray[np.bool_]) -> set[int]:
    """States without which the graph r <- c of `acts` has no cycle: those that act on themselves, then the busiest."""
    free = {int(r) for r in np.flatnonzero(np.diag(acts))}
    left = [r for r in range(len(acts)) if r not in free]
    while left:
        inside = acts[np.ix_(left, left)]
        degree = inside.sum(axis=0) * inside.sum(axis=1)
        if (degree > 0).all():
            free.add(left.pop(int(degree.argmax())))
        else:
            left = [r for r, d in zip(left, degree) if d > 0]
    return free


class _Stage(NamedTuple):
    """How the entries of one level follow: rows from sources, with weights unless they are copies; columns likewise."""

    low: int
    high: int
    sources: Index
    weights: Array | None
    copied: Index
    origin: Index
    made: Index
    support: Index
    columns: Array


class Basis(NamedTuple):
    """Coordinates of symmetric n x n matrices: their entries by rows of the upper triangle, those off it times sqrt 2."""

    rows: npt.NDArray[np.intp]
    columns: npt.NDArray[np.intp]
    scale: Array
    half: Array
    places: npt.NDArray[np.intp]  # of each coordinate in a matrix, and the coordinate of each place
    origins: npt.NDArray[np.intp]


@lru_cache(maxsize=32)
def basis_of(n: int) -> Basis:
    """Return the coordinates of symmetric n x n matrices."""
    rows, columns = np.triu_indices(n)
    scale = np.where(rows == columns, 1.0, np.sqrt(2.0))
    origins = np.empty((n, n), dtype=np.intp)
    origins[rows, columns] = origins[columns, rows] = np.arange(len(rows))
    return Basis(rows, columns, scale, 0.5 * np.outer(scale, scale), rows * n + columns, origins.ravel())


class ShiftStates:
    """The map Y -> W (M Y M') + G on its rows in F, with all other entries made from them.

    Args:
        M: (N, n, n).
        factors: two chains, whose Kronecker product W is row-stochastic or the transpose of such a matrix.
    """

    __slots__ = ("factors", "free", "inverse", "order", "origins", "places", "scale", "shape", "stages", "top", "turned")

    def __init__(self, M: Array, factors: Factors) -> None:
        self.order, self.free, levels = plan_of(M)
        self.factors, self.inverse = factors, np.argsort(self.order)
        n, f = M.shape[-1], self.free
        self.shape = (len(M), f, n)
        inside = self.arranged(M)
        self.turned = np.ascontiguousarray(inside.transpose(0, 2, 1))
        self.top = np.ascontiguousarray(inside[:, :f])
        basis, number = basis_of(n), f * n - f * (f - 1) // 2  # coordinates of the rows in F come first
        self.scale, self.places, self.origins = basis.scale[:number], basis.places[:number], basis.origins[: f * n]
        self.stages = []
        if levels:
            acts = (inside != 0.0).any(axis=0)
            single = (acts.sum(axis=1) == 1) & (inside[:, np.arange(n), acts.argmax(axis=1)] == 1.0).all(axis=0)
            self.stages = [self._stage(inside, acts, single, low, high) for low, high in levels]

    def _stage(self, M: Array, acts: npt.NDArray[np.bool_], single: npt.NDArray[np.bool_], low: int, high: int) -> _Stage:
        copied, made = np.flatnonzero(single[low:]), np.flatnonzero(~single[low:])
        support = np.flatnonzero(acts[low + made].any(axis=0))
        columns = self.turned[:, support[:, None], low + made]
        sources, weights = np.flatnonzero(acts[low:high].any(axis=0)), None
        if single[low:high].all():
            sources = acts[low:high].argmax(axis=1)
        else:
            weights = np.ascontiguousarray(M[:, low:high, sources])
        return _Stage(low, high, sources, weights, copied, acts[low + copied].argmax(axis=1), made, support, columns)

    def arranged(self, family: Array) -> Array:
        """Return a family (N, n, n) in the plan's order."""
        return family[:, self.order][:, :, self.order] if self.free < family.shape[-1] else family

    def restored(self, family: Array) -> Array:
        """Return a family in the order that it came in."""
        return family[:, self.inverse][:, :, self.inverse] if self.free < family.shape[-1] else family

    def pack(self, top: Array) -> Array:
        """Coordinates (N u) of the rows in F (N, f, n), every entry of the symmetric family once; an isometry."""
        return np.asarray(top.reshape(len(top), -1).take(self.places, axis=1) * self.scale).ravel()

    def unpack(self, vector: Array) -> Array:
        """Rows in F (N, f, n) of coordinates."""
        values = vector.reshape(self.shape[0], -1) / self.scale
        return values.take(self.origins, axis=1).reshape(self.shape)

    def expand(self, top: Array, G: Array | None = None) -> Array:
        """Return all of Y (N, n, n), in the plan's order, from its rows in F (N, f, n)."""
        modes, f, n = self.shape
        if f == n:
            return top
        Y = np.empty((modes, n, n))
        Y[:, :f], Y[:, f:, :f] = top, top[:, :, f:].transpose(0, 2, 1)
        for s in self.stages:
            rows = Y[:, s.sources]
            if s.weights is not None:
                rows = s.weights @ rows
            block = np.empty((modes, s.high - s.low, n - s.low))
            block[:, :, s.copied] = rows[:, :, s.origin]
            if s.made.size:
                block[:, :, s.made] = rows[:, :, s.support] @ s.columns
            block = mean(self.factors, block)
            if G is not None:
                block += G[:, s.low : s.high, s.low :]
            Y[:, s.low : s.high, s.low :] = block
            Y[:, s.high :, s.low : s.high] = block[:, :, s.high - s.low :].transpose(0, 2, 1)
        return Y

    def moved(self, Y: Array) -> Array:
        """Return the rows in F of W (M Y M')."""
        return mean(self.factors, self.top @ Y @ self.turned)


def solve_coupled(M: Array, factors: Factors, G: Array, *, tolerance: float = 1e-13, near: Array | None = None) -> Array | None:
    """Return the solution (N, n, n), or None where none was found.

    Args:
        M: (N, n, n).
        factors: W as two chains, see `design.jump_linear.coupled_lyapunov`.
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
    found = gmres(product, states.pack(right), tolerance=tolerance, start=start)
    return None if found is None else states.restored(states.expand(states.unpack(found), G))


def solve_bordered(
    M: Array,
    factors: Factors,
    G: tuple[Array, Array],
    functional: Array,
    level: tuple[float, float],
    *,
    near: Array | None = None,
) -> tuple[Array, float] | None:
    """Return Y (N, n, n) and t with Y = W (M Y M') + G_0 + t G_1 and <H, Y> = c_0 + t c_1, or None where none were found.

    Args:
        M, factors, near: as in `solve_coupled`.
        G: (G_0, G_1), each (N, n, n) symmetric.
        functional: H (N, n, n) symmetric.
        level: (c_0, c_1).
    """
    states = ShiftStates(M, factors)
    G0, G1, H, f = states.arranged(G[0]), states.arranged(G[1]), states.arranged(functional), states.free
    along = states.pack(G1[:, :f])

    def product(vector: Array) -> Array:
        Y = states.expand(states.unpack(vector[:-1]), vector[-1] * G1 if states.stages else None)
        found = np.empty_like(vector)
        np.subtract(vector[:-1] - states.pack(states.moved(Y)), vector[-1] * along, out=found[:-1])
        found[-1] = vector[-1] * level[1] - np.vdot(H, Y)
        return found

    known, offset = G0[:, :f], -level[0]
    if states.stages:
        fixed = states.expand(np.zeros(states.shape), G0)
        known, offset = known + states.moved(fixed), offset + float(np.vdot(H, fixed))
    start = None if near is None else np.append(states.pack(states.arranged(near)[:, :f]), 0.0)
    found = gmres(product, np.append(states.pack(known), offset), tolerance=BORDERED_TOLERANCE, start=start)
    if found is None:
        return None
    t = float(found[-1])
    return states.restored(states.expand(states.unpack(found[:-1]), G0 + t * G1 if states.stages else None)), t


Array = npt.NDArray[np.float64]
Factors = tuple[Array, Array]


def factors_of(transition: Array) -> Factors:
    """Return the two chains whose joint chain this is, (a, a) and (b, b), the sizes most alike; (1, 1) and itself if none are.

    Args:
        transition: (N, N) row-stochastic, or bounds of such a matrix.

    >>> first, second = factors_of(np.kron([[0.5, 0.5], [0.25, 0.75]], [[0.125, 0.875], [1.0, 0.0]]))
    >>> first.tolist(), second.tolist()
    ([[0.5, 0.5], [0.25, 0.75]], [[0.125, 0.875], [1.0, 0.0]])
    """
    N = len(transition)
    for b in sorted((b for b in range(2, N) if N % b == 0), key=lambda b: b + N // b):
        blocks = transition.reshape(N // b, b, N // b, b)
        first = blocks[:, 0].sum(axis=2)
        k, l = np.unravel_index(first.argmax(), first.shape)
        if first[k, l] > 0.0:
            second = blocks[k, :, l] / first[k, l]
            if np.abs(np.kron(first, second) - transition).max() <= 4.0 * np.finfo(float).eps:
                return first, second
    return np.ones((1, 1)), transition


def transposed_factors(factors: Factors) -> Factors:
    """Return the factors of the transpose."""
    first, second = factors
    return np.ascontiguousarray(first.T), np.ascontiguousarray(second.T)


def mean(factors: Factors, family: Array) -> Array:
    """Return sum_j w_ij Y_j for W = kron(first, second) and a family Y (N, ...)."""
    first, second = factors
    if len(first) == 1:
        return np.asarray((second @ family.reshape(len(family), -1)).reshape(family.shape))
    inner = second @ family.reshape(len(first), len(second), -1)
    return np.asarray((first @ inner.reshape(len(first), -1)).reshape(family.shape))
