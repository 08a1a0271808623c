"""Mean and spread of the tracking error of any experiment, exactly, transients included.

In coordinates of deviation from the ideal response (7.8) the loop is X(k+1) = A_i X(k) + B w(k), its reference steps
are jumps of X, and everything random is the mode. With xi = [X; 1] and eta = the coordinates of xi xi',

    eta(k+1) = W_i eta(k),      s(k+1) = s(k) + T |e(k)|^2      (linear in eta)

is a jump-linear system again, so one recursion of the second moments of [eta; s] gives, at every slot, the mean of the error
(through the 1), its variance, mean and variance of its square, and mean and variance of the sums of Table 7.2. Those of eta are
fourth moments of xi: each is computed once, as a monomial, and not for every order of its factors.

Before slot 0 the plant was at rest in its first state: the samples that the first packet carries beside the newest are
y(0). Before the first sample has come the controller answers zeros, and before the first packet the input is 0. An actuator
that has no packet measures no delay, and a row that is chosen by this delay is that of the longest one. The rows of packets
under way when the reference steps were computed for the old one. What else acts on the state and is known (a load) is a drive
f(k). All of this is in the recursion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from design.controllers import Selection
from design.errors import FieldError
from design.jump_linear.coupled_lyapunov import factors_of, mean, transposed_factors
from design.jump_linear.higher_moments import monomials, power_entries
from design.networked_loop import check_gains, check_held, steady_state
from design.networked_loop.affine_loop import LoopStructure
from design.networked_loop.closed_loop import loop_structure
from design.processes.delay_chain import Array, DelayChain, as_chain

SPARSE = 0.05
"""Share of a matrix's entries that are not zero, below which these are multiplied one by one."""
LARGE = 2**15
"""Entries of all modes that are not zero, from which on the import of scipy pays."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """Exact moments of the tracking error e = y - target at slots k = 0..K-1 over the randomness of the network.

    Args:
        error_mean, error_sd: (K, p) in output units.
        square_mean, square_sd: (K,) of |e(k)|^2, e over the tracked outputs.
        sum_mean, sum_sd: (sums,) of T sum |e(k)|^2 from each start slot on, output units squared times s.
    """

    error_mean: Array
    error_sd: Array
    square_mean: Array
    square_sd: Array
    sum_mean: Array
    sum_sd: Array


def predict_tracking(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    Lambda: DelayChain | npt.ArrayLike,
    Pi: DelayChain | npt.ArrayLike,
    gains: npt.ArrayLike,
    selection: Selection | str,
    reference: npt.ArrayLike,
    *,
    period_s: float,
    target: npt.ArrayLike | None = None,
    disturbance: npt.ArrayLike | None = None,
    initial: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    x0: npt.ArrayLike | None = None,
    drive: npt.ArrayLike | None = None,
    tracked: Sequence[int] | None = None,
    samples: int = 1,
    integral: bool = False,
    sums_from: tuple[int, ...] = (0,),
) -> Prediction:
    """Predict the tracking error of an experiment.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.
        Lambda, Pi: S-C and C-A transition matrices or delay chains.
        gains, selection: the loop's gains and row rule.
        reference: (K,) or (K, p), r(k).
        period_s: sample period T, s.
        target: (K,) or (K, p), what y is compared with; default the reference. Tables 7.1 and 7.2 count the error to the
            step's value from t = 0 on.
        disturbance: (K,) or (K, m) input disturbance w(k); default none.
        initial: distributions of the S-C and C-A mode at k = 0; default stationary.
        x0: (n,) plant state at k = 0 and before; default 0.
        drive: (K, n), f(k) in x(k+1) = A x(k) + B (u(k) + w(k)) + f(k), states' units; default none.
        tracked: outputs whose squares are summed, of one unit; default all.
        samples, integral: as the gains were designed.
        sums_from: start slots of the sums.

    Raises:
        ValueError: wrong shapes.
        DesignError: a reference that no input holds.
    """
    from design.whole_process import one_blas_thread

    sc, ca = as_chain(Lambda, "Lambda"), as_chain(Pi, "Pi")
    structure = loop_structure(A, B, C, sc, ca, selection, samples=samples, integral=1.0 if integral else 0.0)
    K = check_gains(gains, structure.gain_shape)
    n, p, m = structure.plant_order, np.shape(C)[0], structure.B.shape[2]
    r = _signal(reference, p, "reference", None)
    aim = r if target is None else _signal(target, p, "target", len(r))
    w = _signal(np.zeros((len(r), m)) if disturbance is None else disturbance, m, "disturbance", len(r))
    star = steady_state(A, B, C) if r.any() else None
    if star is not None:
        check_held(A, B, C, r)
    f = _signal(np.zeros((len(r), n)) if drive is None else drive, n, "drive", len(r))
    output = np.asarray(C, dtype=np.float64)
    summed = np.zeros(p)
    summed[list(range(p) if tracked is None else tracked)] = 1.0
    walk = _Recursion(structure, K, (sc, ca), period_s, output, sums_from, summed)

    def ideal(value: Array) -> Array:
        """Steady closed-loop state at a constant reference."""
        if star is None:
            return np.zeros(structure.base.shape[-1])
        inputs = (structure.base.shape[-1] - n - structure.stored_outputs * p - (p if structure.integral else 0)) // m
        return np.concatenate([
            star.state @ value, np.tile(value, structure.stored_outputs), np.zeros(p if structure.integral else 0),
            np.tile(star.input @ value, inputs),
        ])  # fmt: skip

    start = -ideal(r[0])
    if x0 is not None:
        first = np.asarray(x0, dtype=np.float64)
        start[:n] += first
        start[n : n + structure.stored_outputs * p] += np.tile(output @ first, structure.stored_outputs)
    with one_blas_thread():
        walk.begin(start, _initial_modes(structure, sc, ca, initial))
        mean, variance, square, fourth = np.empty((len(r), p)), np.empty((len(r), p)), np.empty(len(r)), np.empty(len(r))
        for k in range(len(r)):
            if k and (r[k] != r[k - 1]).any():
                walk.jump(ideal(r[k - 1]) - ideal(r[k]))
            walk.aim(r[k] - aim[k])
            mean[k], variance[k], square[k], fourth[k] = walk.read()
            hold = np.zeros(m) if star is None else star.input @ r[k]
            walk.step(k, w[k], f[k], hold)
        sums = walk.sums()
    return Prediction(
        error_mean=mean,
        error_sd=np.sqrt(np.maximum(variance, 0.0)),
        square_mean=square,
        square_sd=np.sqrt(np.maximum(fourth - square**2, 0.0)),
        sum_mean=sums[0],
        sum_sd=np.sqrt(np.maximum(sums[1] - sums[0] ** 2, 0.0)),
    )


class _Recursion:
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
        self._powers: dict[bytes, tuple[Any, Any]] = {}
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
            self._powers[A.tobytes()] = power_entries(A, 2), power_entries(A, 4)
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
        """No sample has come yet: rows are 0, u* below the ideal, and no error is added to the integral."""
        s, e = self.structure, self.structure.entries
        for index in np.flatnonzero(quiet[e.mode]):
            mode = e.mode[index]
            affine[mode, :-1, :-1] -= e.left[index] @ self.gains[e.sc[index], rows[index]] @ e.right[index]
            affine[mode, :-1, -1] -= e.left[index] @ hold
        if s.integral:
            at = s.plant_order + s.stored_outputs * self.p
            for mode in np.flatnonzero(quiet):
                affine[mode, at : at + self.p, :-1] = 0.0
                affine[mode, at : at + self.p, at : at + self.p] = np.eye(self.p)

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


def _signal(values: npt.ArrayLike, width: int, name: str, length: int | None) -> Array:
    array = np.asarray(values, dtype=np.float64)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.shape[1] != width or (length is not None and len(array) != length):
        raise FieldError(name, f"shape {array.shape}, expected ({length or 'K'}, {width})")
    if not np.isfinite(array).all():
        raise FieldError(name, "not finite")
    return array


def _initial_modes(
    structure: LoopStructure, sc: DelayChain, ca: DelayChain, initial: tuple[npt.ArrayLike, npt.ArrayLike] | None
) -> Array:
    """Distribution of the joint mode at k = 0; the C-A delay of the slot before counts as that of the first one."""
    laws = [sc.stationary, ca.stationary] if initial is None else [np.asarray(v, dtype=np.float64) for v in initial]
    for name, law, chain in zip(("initial[0]", "initial[1]"), laws, (sc, ca), strict=True):
        if law.shape != (chain.modes,) or (law < 0).any() or abs(law.sum() - 1.0) > 1e-9:
            raise FieldError(name, f"expected {chain.modes} probabilities that sum to 1")
    weights = laws[0][structure.sc_mode] * laws[1][structure.ca_mode]
    if structure.selection == "previous":  # of the modes that differ in the slot before only, one carries the weight
        every, weights = weights, np.zeros_like(weights)
        for s, c in set(zip(structure.sc_mode.tolist(), structure.ca_mode.tolist())):
            same = np.flatnonzero((structure.sc_mode == s) & (structure.ca_mode == c))
            chosen = same[np.argmin(np.abs(structure.ca_before[same] - c))]
            weights[chosen] = every[chosen]
    share = float(weights.sum())
    if not share > 0.0:
        raise FieldError("initial", "puts all on pairs of modes that never meet")
    return np.asarray(weights if share > 1.0 - 1e-9 else weights / share)  # pairs that are never met have none
