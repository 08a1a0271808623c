"""*Send all, apply one* in many runs at once, each bit for bit what `GainRows` computes alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import KnownInBatch, LoopModel, Selection
from design.controllers.exact_products import dot, pseudo_inverse

Matrix = NDArray[np.float64]


def feedforward(model: LoopModel) -> NDArray[np.float64]:
    r"""Return :math:`\Omega_{22}` (m x p), so that :math:`\tilde u^* = \Omega_{22} \bar r` (thesis (7.6)-(7.7)).

    With p < m the minimum-norm solution :math:`N^T(NN^T)^{-1}` is taken, as printed. With p > m the outputs cannot all be chosen:
    it holds for the references that some input holds, see `held_exactly`.

    Raises:
        ValueError: if p <= m and N is rank deficient: no steady state tracks every reference.
    """
    matrices = (model.A, model.B, model.C)
    return np.array(_feedforward(*(tuple(map(tuple, M.tolist())) for M in matrices)))


@lru_cache(maxsize=16)
def _feedforward(*matrices: tuple[tuple[float, ...], ...]) -> list[list[float]]:
    A, B, C = map(np.array, matrices)
    (n, m), p = B.shape, len(C)
    N = np.block([[A - np.eye(n), B], [C, np.zeros((p, m))]])
    if p <= m and np.linalg.matrix_rank(N) < n + p:
        raise ValueError(f"no steady state tracks every reference: [[A - I, B], [C, 0]] has rank < {n + p}")
    found: list[list[float]] = pseudo_inverse(N)[n:, n:].tolist()
    return found


def held_exactly(model: LoopModel, r: Sequence[float]) -> bool:
    """Return whether some state and input hold the outputs at r.

    Args:
        model: the loop.
        r: reference, (p,).

    Reference: thesis (7.6).
    """
    n, m = model.B.shape
    N = np.block([[model.A - np.eye(n), model.B], [model.C, np.zeros((len(r), m))]])
    aim = np.concatenate([np.zeros(n), np.asarray(r, dtype=np.float64)])
    return bool(np.abs(N @ (np.linalg.pinv(N) @ aim) - aim).max() <= 1e-9 * max(1.0, np.abs(aim).max()))


def sojourn_ranges(sojourns: Sequence[int]) -> list[tuple[int, int]]:
    """Return for every tau the first and the last of its gains; see `design.controllers.gain_rows.GainIndex`."""
    first = [sum(sojourns[:tau]) for tau in range(len(sojourns))]
    own = [tau for tau, count in enumerate(sojourns) if count]
    taken = [next((other for other in own if other >= tau), own[-1]) for tau in range(len(sojourns))]
    return [(first[tau], first[tau] + sojourns[tau] - 1) for tau in taken]


class BatchGainRows:
    """u = u* + K[tau, row] Y in many runs; see `GainRows`, whose sums these are, in the same order.

    Args:
        K: gains, (tables, rows, m, width).
        selection: how the actuator picks a row.
        model: the loop.
        runs: how many.
        integral: whether the gains have p columns for the sum of the newest errors.
        sojourns: how many tables every tau has.
        limit: largest size of each sum; empty: any.
    """

    def __init__(
        self, K: Matrix, selection: Selection, model: LoopModel, runs: int, integral: bool = False, sojourns: Sequence[int] = (),
        limit: Sequence[float] = (),
    ) -> None:  # fmt: skip
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
        gains = self._gains.take(self._gain(started, tau), axis=-1)
        if self._scalar:
            scalar: Matrix = self._omega[0][0] * r[0] + gains[:, :, 0] * (y[0] - r[0])
            return scalar
        error = [row - r[j % len(r)] for j, row in enumerate(y)]
        summands = [*error, *self._sum]
        if len(self._sum):
            added = self._sum + np.array(error[: len(self._sum)])
            added = np.clip(added, -self._limit, self._limit) if len(self._limit) else added
            self._sum = np.where(started, added, self._sum)
        total = np.zeros((gains.shape[0], gains.shape[1], gains.shape[3]))
        for j, x in enumerate(summands):
            total += gains[:, :, j] * x
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
