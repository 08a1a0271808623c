"""One slot after the other: the moments of the deviation from the ideal response, and of the sums of its squares.

See `design.networked_loop.prediction`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from design.errors import TooLarge
from design.jump_linear.coupled_lyapunov import factors_of, mean, transposed_factors
from design.jump_linear.higher_moments import monomials, power_entries
from design.networked_loop.affine_loop import LoopStructure
from design.processes.delay_chain import Array, DelayChain

SPARSE = 0.05
"""Share of a matrix's entries that are not zero, below which these are multiplied one by one."""
LARGE = 2**15
"""Entries of all modes that are not zero, from which on the import of scipy pays."""
MOST_ENTRIES = 3e7
"""Entries of the matrices by which fourth moments go on, up to which these are made: some seconds, and 0.7 GB."""


class MomentRecursion:
    """Fourth moments of xi, and second moments of s with eta and itself, mode by mode.

    A vector of every mode: the monomials of degree 4 in xi; then, of every sum, s times those of degree 2, and s^2. A slot is
    linear in it: monomials of A xi are those of xi times A^[4], and s + T |e|^2 has |e|^2 = q xi^[2].
    """

    def __init__(
        self, structure: LoopStructure, gains: Array, chains: tuple[DelayChain, DelayChain], period_s: float, C: Array,
        sums_from: tuple[int, ...], summed: Array,
    ) -> None:  # fmt: skip
        self.structure, self.gains, self.sums_from = structure, gains, sums_from
        sc, ca = chains
        self.tau, self.received = sc.delay[structure.sc_mode], ca.delay[structure.ca_mode]
        self.received_before = ca.delay[structure.ca_before] if structure.selection == "previous" else self.received
        self.d = structure.base.shape[-1] + 1
        _, self.pairs, triples, quads = monomials(self.d, 4)
        self.product = quads.times[self.pairs.first[:, None], triples.times[self.pairs.parent]]
        self.period_s, self.p, self.summed = period_s, C.shape[0], summed
        self.G = np.zeros((self.p, self.d))
        self.G[:, : C.shape[1]] = C
        self.aim(np.zeros(self.p))
        self.closed = structure.matrices(gains)
        self._moves: dict[tuple[object, ...], Callable[[Array], Array]] = {}
        self._powers: dict[bytes, list[Any]] = {}
        self._followed = _following(structure.transition)
        self.M: Array = np.empty(0)

    def aim(self, offset: Array) -> None:
        """e = C x^ + offset, offset = r - target."""
        self.G[:, -1] = offset
        square, (u, v) = self.G.T @ (self.summed[:, None] * self.G), (self.pairs.first, self.pairs.parent)
        self.square = np.where(u == v, 1.0, 2.0) * square[u, v]

    def begin(self, X: Array, weights: Array) -> None:
        """Start at a known state, with the mode's distribution."""
        value = np.ones(1)
        for degree in monomials(self.d, 4):
            value = np.append(X, 1.0)[degree.first] * value[degree.parent]
        self.M = weights[:, None] * np.pad(value, (0, len(self.sums_from) * (len(self.square) + 1)))

    def jump(self, shift: Array) -> None:
        """X <- X + shift: the reference steps."""
        affine = np.broadcast_to(np.eye(self.d), (len(self.M), self.d, self.d)).copy()
        affine[:, :-1, -1] = shift
        self.M = self._move(affine, np.zeros(len(self.sums_from)))(self.M)

    def step(self, k: int, w: Array, f: Array, hold: Array) -> None:
        """One slot under the disturbance w and the drive f; `hold` is u*, from which the silent first packets deviate."""
        silent = bool((self.tau > k).any())
        counted = tuple(k >= first for first in self.sums_from)
        rows, early = self._rows(k)
        held = hold.tobytes() if silent else b""
        key = (k if silent or early else -1, w.tobytes(), f.tobytes(), held, counted, self.G[:, -1].tobytes())
        if key not in self._moves:
            affine = np.zeros((self.closed.shape[0], self.d, self.d))
            affine[:, :-1, :-1] = self.structure.matrices(self.gains, rows) if early else self.closed
            affine[:, -1, -1] = 1.0
            affine[:, :-1, -1] = self.structure.B @ w
            affine[:, : f.size, -1] += f
            if silent:
                self._silence(affine, self.tau > k, hold, rows)
            self._moves[key] = self._move(affine, self.period_s * np.array(counted, dtype=np.float64))
        self.M = self._followed(self._moves[key](self.M))

    def _move(self, affine: Array, weights: Array) -> Callable[[Array], Array]:
        """Return what takes the moments of every mode through xi <- A xi, s <- s + weight |e|^2."""
        if (entries := float((np.count_nonzero(affine, axis=(1, 2)) ** 4.0).sum()) / 24.0) > MOST_ENTRIES:
            raise TooLarge(f"fourth moments of {len(affine)} modes with {self.d - 1} states have {entries:.2g} entries")
        kinds, which = np.unique(affine.reshape(len(affine), -1), axis=0, return_inverse=True)
        found = [self._entries(A.reshape(affine.shape[1:]), weights) for A in kinds]
        width = self.M.shape[1]
        row, column = (np.concatenate([found[i][at] + n * width for n, i in enumerate(which.ravel())]) for at in (0, 1))
        values, size = np.concatenate([found[i][2] for i in which.ravel()]), self.M.size
        if len(values) < LARGE:
            return lambda M: np.asarray(np.bincount(row, values * M.ravel()[column], size), dtype=np.float64).reshape(M.shape)
        from scipy.sparse import csr_array  # a seventh of the time of `hil report`, which seldom needs it

        matrix: Any = csr_array((values, (row, column)), shape=(size, size))
        return lambda M: np.asarray(matrix @ M.ravel()).reshape(M.shape)

    def _entries(self, A: Array, weights: Array) -> tuple[Array, ...]:
        """Rows, columns and values of what `_move` does in one mode."""
        if A.tobytes() not in self._powers:
            self._powers[A.tobytes()] = power_entries(A, 2, 4)
        (row, column, value), whole = self._powers[A.tobytes()]
        found, at = [whole], self.product.max() + 1
        error = np.flatnonzero(self.square)
        for weight in weights:
            last, own = at + len(self.square), weight * self.square[error]
            found += [(at + row, at + column, value), (np.array([last]), np.array([last]), np.ones(1))]
            if weight:
                found += [
                    (np.repeat(at + row, len(error)), self.product[np.ix_(column, error)].ravel(), np.outer(value, own).ravel()),
                    (np.full(len(error), last), at + error, 2.0 * own),
                    (np.full(len(error) ** 2, last), self.product[np.ix_(error, error)].ravel(), np.outer(own, own).ravel()),
                ]
            at = last + 1
        return tuple(np.concatenate(each) for each in zip(*found))

    def _rows(self, k: int) -> tuple[npt.NDArray[np.int64], bool]:
        """Rows of the entries in slot k, and whether some are others than later: no packet had come whose delay chooses them."""
        rows, mode, selection = self.structure.entries.row, self.structure.entries.mode, self.structure.selection
        if selection in ("constant", "applied"):
            return rows, False
        none = self.received_before > k - 1 if selection == "previous" and k else self.received > k
        if not none.any():
            return rows, False
        count = self.gains.shape[1]
        labels = math.isqrt(count) if selection == "both" else count
        longest = count - labels + rows % labels if selection == "both" else np.full_like(rows, count - 1)
        return np.where(none[mode], longest, rows), True

    def _silence(self, affine: Array, quiet: npt.NDArray[np.bool_], hold: Array, rows: npt.NDArray[np.int64]) -> None:
        """No sample has come yet: rows are 0, u* below the ideal, and the controller's own states stay."""
        s, e = self.structure, self.structure.entries
        for index in np.flatnonzero(quiet[e.mode]):
            mode = e.mode[index]
            affine[mode, :-1, :-1] -= e.left[index] @ self.gains[e.sc[index], rows[index]] @ e.right[index]
            affine[mode, :-1, -1] -= e.left[index] @ hold
        end = self.d - 1 - s.behind
        affine[quiet, end - s.own_states : end] = np.eye(s.own_states, self.d, end - s.own_states)

    def read(self) -> tuple[Array, Array, float, float]:
        """E e and its variance per output, E |e|^2, E |e|^4 at this slot."""
        M = self.M[:, : self.product.max() + 1].sum(axis=0)
        pairs = M[self.product[-1]]  # the last coordinate of eta is 1 * 1
        moment = pairs[self.pairs.times]
        C, mean = self.G[:, :-1], self.G[:, :-1] @ moment[:-1, -1]  # from the ideal response: the rest of e is known
        return (
            mean + self.G[:, -1],
            np.einsum("ca,ab,cb->c", C, moment[:-1, :-1], C) - mean**2,
            float(self.square @ pairs),
            float(self.square @ M[self.product] @ self.square),
        )

    def sums(self) -> tuple[Array, Array]:
        """E s and E s^2 of every sum."""
        M = self.M.sum(axis=0)[self.product.max() + 1 :].reshape(len(self.sums_from), -1)
        return M[:, -2], M[:, -1]


def sparse(matrix: Array) -> Any:
    """Return a matrix, sparse where most of it is zero: where a mode is followed by few, as in a stay of many slots."""
    if np.count_nonzero(matrix) >= SPARSE * matrix.size:
        return np.ascontiguousarray(matrix)
    from scipy.sparse import csr_array  # a seventh of the time of `hil report`, which seldom needs it

    return csr_array(matrix)


def _following(transition: Array) -> Callable[[Array], Array]:
    """Return what takes moments (N, ...) to the next slot: where its modes are those of two chains together, chain by chain."""
    followed = sparse(transition.T)
    if not isinstance(followed, np.ndarray):
        return lambda M: np.asarray(followed @ M)
    return partial(mean, transposed_factors(factors_of(transition)))
