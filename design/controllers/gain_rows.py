"""The rows of *send all, apply one*, one slot after the other (7.9)-(7.13): in one loop, and in many runs at once.

Each of many runs has bit for bit what one alone computes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from design.controllers.contract import Gains, Known, KnownInBatch, LoopModel, Rows, RunningController, Selection, StateGains
from design.controllers.exact_products import Matrix, dot, of_size_one, pseudo_inverse, rank_of
from design.errors import DesignError


def nested(array: Matrix) -> Any:
    """Return an array as the nested tuples that an experiment file holds."""
    return _tuples(array.astype(np.float64).tolist())


def _tuples(values: Any) -> Any:
    return tuple(map(_tuples, values)) if isinstance(values, list) else values


class SteadyState(NamedTuple):
    """x* = state @ r and u* = input @ r: Omega_12 (n, p) and Omega_22 (m, p) of (7.7)."""

    state: Matrix
    input: Matrix


def steady_state(A: npt.ArrayLike, B: npt.ArrayLike, C: npt.ArrayLike) -> SteadyState:
    """Omega_12 and Omega_22; with more inputs than outputs the solution of least norm, as printed.

    More outputs than inputs cannot follow any reference: there the two hold for the references that `held_exactly` lets pass.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.

    Raises:
        DesignError: p <= m, and N = [[A - I, B], [C, 0]] has not full row rank, which is `value`.

    >>> steady_state([[0.5]], [[1.0]], [[1.0]]).input.round(9).tolist()
    [[0.5]]
    """
    N, (n, m), p = _stacked(A, B, C), np.shape(B), np.shape(C)[0]
    if p <= m and (rank := rank_of(N)) < n + p:
        said = f"[[A - I, B], [C, 0]] has rank {rank}, expected {n + p}"
        raise DesignError(f"no steady state tracks every reference: {said}", value=rank)
    right = pseudo_inverse(N)[:, n:]
    return SteadyState(right[:n], right[n:])


def feedforward(model: LoopModel) -> Matrix:
    r"""Return :math:`\Omega_{22}` (m x p), so that :math:`\tilde u^* = \Omega_{22} \bar r` (thesis (7.6)-(7.7)).

    Raises:
        DesignError: as of `steady_state`.
    """
    return steady_state(model.A, model.B, model.C).input


def held_exactly(A: npt.ArrayLike, B: npt.ArrayLike, C: npt.ArrayLike, references: npt.ArrayLike) -> bool:
    """Return whether some state and input hold the outputs at each of some references, whatever the units are.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.
        references: (p,), or (K, p).

    Reference: thesis (7.6).
    """
    N, aims = _stacked(A, B, C), np.atleast_2d(references).T
    M = of_size_one(np.hstack([N, np.vstack([np.zeros((len(N) - len(aims), aims.shape[1])), aims])]))
    moves, aims = np.hsplit(M, [N.shape[1]])
    return bool(np.abs(moves @ (np.linalg.pinv(moves) @ aims) - aims).max(initial=0.0) <= 1e-9)


def nearest_held(A: npt.ArrayLike, B: npt.ArrayLike, C: npt.ArrayLike, reference: npt.ArrayLike) -> list[float]:
    """Return the outputs next to a reference, by least squares, at which some state and input hold them.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.
        reference: (p,).

    >>> nearest_held([[0.5, 0.0], [0.0, 0.5]], [[1.0], [0.0]], [[1.0, 0.0], [0.0, 1.0]], [3.0, 1.0])
    [3.0, 0.0]
    """
    moves = _stacked(A, B, C)[: (n := len(np.asarray(A)))]
    held = np.asarray(C) @ np.linalg.svd(moves)[2][np.linalg.matrix_rank(moves) :, :n].T
    found = held @ (np.linalg.pinv(held) @ np.asarray(reference))
    return [float(f"{y:.12g}") if abs(y) > 1e-12 * np.abs(found).max() else 0.0 for y in found]


def _stacked(A: npt.ArrayLike, B: npt.ArrayLike, C: npt.ArrayLike) -> Matrix:
    """N = [[A - I, B], [C, 0]], which takes a state and an input that are held to 0 and the outputs."""
    A, B, C = (np.asarray(M, dtype=np.float64) for M in (A, B, C))
    return np.block([[A - np.eye(len(A)), B], [C, np.zeros((len(C), B.shape[1]))]])


def sojourn_ranges(sojourns: Sequence[int]) -> list[tuple[int, int]]:
    """Return for every tau the first and the last of its gains; see `GainIndex`."""
    first = [sum(sojourns[:tau]) for tau in range(len(sojourns))]
    own = [tau for tau, count in enumerate(sojourns) if count]
    taken = [next((other for other in own if other >= tau), own[-1]) for tau in range(len(sojourns))]
    return [(first[tau], first[tau] + sojourns[tau] - 1) for tau in taken]


class GainIndex:
    """Counts for how long the measured tau has lasted, and says which gain belongs to both.

    Args:
        sojourns: how many gains every tau has, for 1, 2, ... slots at this tau; the last one stands for all longer ones. A tau
            without gains, as of a packet that comes late, has those of the next larger one, beyond the end those of the last.
    """

    def __init__(self, sojourns: Sequence[int]) -> None:
        self._range = sojourn_ranges(sojourns)
        self._tau = self._index = self._last = -1

    def at(self, tau: int) -> int:
        """Return the index of the gain; called once a slot, in order."""
        if tau != self._tau:
            self._tau = tau
            self._index, self._last = self._range[tau] if tau < len(self._range) else self._range[-1]
        elif self._index < self._last:
            self._index += 1
        return self._index


class GainRows:
    """u = u* + K[tau, row] Y, see `GainIndex`.

    Y is the error y - r of every sample in the packet, newest first, and with ``integral`` below these the sum of the newest
    errors of all earlier slots; where it has a `limit` for each output, the sum is clamped to it in every slot. With `state`,
    (tables, c, width), Y ends with xi(k), and xi(k+1) = state[tau] Y.
    """

    def __init__(
        self, K: Matrix, selection: Selection, model: LoopModel, integral: bool = False, sojourns: Sequence[int] = (),
        limit: Sequence[float] = (), state: StateGains = (),
    ) -> None:  # fmt: skip
        self.selection = selection
        self._state, self._xi = state, [0.0] * len(state[0]) if state else []
        self._limit = tuple(map(float, limit))
        self._sum = [0.0] * model.C.shape[0] if integral else []
        self._gains: Gains = nested(K)
        self._index = GainIndex(sojourns or (1,) * len(K))
        self._omega: Rows = nested(feedforward(model))
        # One input, one output: the same sums without loops in loops, 18 % of an interpreted virtual slot.
        scalar = K.shape[2:] == (1, 1)
        self._scalars = [[mat[0][0] for mat in rows] for rows in self._gains] if scalar else None

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        if self._scalars is not None:
            error, held = y[0] - r[0], self._omega[0][0] * r[0]
            return tuple([(held + g * error,) for g in self._scalars[self._index.at(tau)]])
        e = [a - b for a, b in zip(y, cycle(r))]
        known, index = e + self._sum + self._xi, self._index.at(tau)
        self._sum = [s + x for s, x in zip(self._sum, e)]
        if self._limit:
            self._sum = [min(max(s, -most), most) for s, most in zip(self._sum, self._limit)]
        if self._state:
            self._xi = [dot(row, known) for row in self._state[index]]
        star = [dot(row, r) for row in self._omega]
        return tuple([tuple([s + dot(gains, known) for s, gains in zip(star, mat)]) for mat in self._gains[index]])


class NodeGainRows:
    r"""u = u* + K[(\tau_1, \ldots, \tau_q), row] (y - r), y the newest sample of every output; see `MultiSampleController`.

    Until a packet of every node has come it answers zeros, as a controller of one node does before its first sample. It does not
    wait for a node that may keep silent by its trigger or its clock: its outputs count as 0, its age as the oldest.

    Args:
        running: the rows of a table by its index; it takes the index where it expects tau.
        model: the loop, with its sensor nodes.
        ages: how many ages of each node have tables; an older sample has the gains of the oldest.
        rows: rows of a packet.
    """

    memory = 0

    def __init__(self, running: RunningController, model: LoopModel, ages: Sequence[int], rows: int) -> None:
        nodes = model.nodes
        self.selection = running.selection
        self._rows, self._ages, self._outputs = running.rows, tuple(ages), nodes.outputs
        self._waited = {i for i, name in enumerate(nodes.names) if name not in nodes.silent}
        self._none: Rows = ((0.0,) * model.B.shape[1],) * rows
        self._width = model.C.shape[0]

    def rows(self, k: int, known: Known) -> Rows:
        """Return the rows of slot k; see `MultiSampleController.rows`."""
        y, age, received = [0.0] * self._width, [count - 1 for count in self._ages], set()
        for node, slot, values in known.samples:  # newest first
            if node not in received:
                received.add(node)
                age[node] = k - slot
                for output, value in zip(self._outputs[node], values):
                    y[output] = value
        if not self._waited <= received:
            return self._none
        index = 0
        for own, count in zip(age, self._ages):
            index = index * count + min(own, count - 1)
        return self._rows(k, index, y, known.reference)


class BatchGainRows:
    """u = u* + K[tau, row] Y in many runs; see `GainRows`, whose sums these are, in the same order.

    Args:
        K: gains, (tables, rows, m, width).
        selection: how the actuator picks a row.
        model: the loop.
        runs: number of runs.
        integral: whether the gains have p columns for the sum of the newest errors.
        sojourns: how many tables every tau has.
        limit: largest size of each sum; empty: any.
        state: (tables, c, width), by which states of its own go on; empty: none.
    """

    def __init__(
        self, K: Matrix, selection: Selection, model: LoopModel, runs: int, integral: bool = False, sojourns: Sequence[int] = (),
        limit: Sequence[float] = (), state: StateGains = (),
    ) -> None:  # fmt: skip
        self._state = np.ascontiguousarray(np.moveaxis(np.array(state), 0, -1)) if state else None  # (c, width, tables)
        self._xi = np.zeros((0 if self._state is None else len(self._state), runs))
        self._limit = np.array(limit, dtype=np.float64)[:, None]
        self.selection = selection
        self.memory: int | None = None
        p = model.C.shape[0]
        self._sum = np.zeros((p if integral else 0, runs))
        self._scalar = K.shape[2:] == (1, 1)
        self._gains = np.ascontiguousarray(np.moveaxis(K, 0, -1))  # (rows, m, width, tables)
        self._omega = [tuple(map(float, row)) for row in feedforward(model)]
        ranges = sojourn_ranges(sojourns or (1,) * len(K))
        self._first, self._last = (np.array(column, dtype=np.intp) for column in zip(*ranges))
        self._counts = bool((self._last > self._first).any())
        self._tau = np.full(runs, -1, dtype=np.intp)
        self._index = np.full(runs, -1, dtype=np.intp)

    def rows(self, k: int, known: KnownInBatch) -> Matrix:
        """Return the rows of slot k, (rows, m, runs); where a run has not started they mean nothing and change nothing.

        Args:
            k: slot.
            known: the oldest of the newest samples says tau.
        """
        started, y, r = known.started, known.y, known.reference
        tau = known.ages[0] if len(known.ages) == 1 else known.ages.max(axis=0)
        tables = self._gain(started, tau)
        gains = self._gains.take(tables, axis=-1)
        if self._scalar:
            scalar: Matrix = self._omega[0][0] * r[0] + gains[:, :, 0] * (y[0] - r[0])
            return scalar
        error = [row - r[j % len(r)] for j, row in enumerate(y)]
        summands = [*error, *self._sum, *self._xi]
        if len(self._sum):
            added = self._sum + np.array(error[: len(self._sum)])
            added = np.clip(added, -self._limit, self._limit) if len(self._limit) else added
            self._sum = np.where(started, added, self._sum)
        if self._state is not None:
            self._xi = np.where(started, _products(self._state.take(tables, axis=-1), summands), self._xi)
        total = _products(gains, summands)
        star = np.array([dot(row, r) for row in self._omega])
        return star[:, None] + total

    def _gain(self, started: NDArray[np.bool_], tau: NDArray[np.intp]) -> NDArray[np.intp]:
        at = np.minimum(tau, len(self._first) - 1)
        first = self._first.take(at)
        if not self._counts:
            return first
        index = np.where(tau == self._tau, np.minimum(self._index + 1, self._last.take(at)), first)
        self._tau, self._index = np.where(started, tau, self._tau), np.where(started, index, self._index)
        return index


def _products(gains: Matrix, summands: Sequence[Matrix]) -> Matrix:
    """Gains (..., width, runs) times what is known, (runs,) each, summed in its order as one run alone does."""
    total = np.zeros((*gains.shape[:-2], gains.shape[-1]))
    for j, x in enumerate(summands):
        total += gains[..., j, :] * x
    return total


class NodeGainRowsOfMany:
    """The gains of every node's age in many runs, each bit for bit what `NodeGainRows` computes alone.

    Args:
        running: the rows of a table by its index.
        ages: how many ages of each node have tables.
    """

    def __init__(self, running: BatchGainRows, ages: Sequence[int]) -> None:
        self._running, self._counts = running, tuple(ages)
        self.selection: Selection = running.selection
        self.memory: int | None = None

    def rows(self, k: int, known: KnownInBatch) -> Matrix:
        """Return the rows of slot k, (rows, m, runs), by the age of every node's newest sample."""
        index = np.zeros(known.ages.shape[1], dtype=np.intp)
        for i, count in enumerate(self._counts):
            index = index * count + np.minimum(known.ages[min(i, len(known.ages) - 1)], count - 1)
        return self._running.rows(k, known._replace(ages=index[None]))
