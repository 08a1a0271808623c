"""Paths of semi-Markov processes and of the states between their jumps, for a whole batch of runs at once.

A *visit* is a time interval in which no process jumps. Batches of visits come in order: the k-th batch holds the k-th
visit of every run that is not at its end yet, sampled exactly from one draw of Exp(1) and one of U(0, 1) per jump.

Between two jumps a state moves by `MatrixFlow`, with no Python per point.

References: thesis Section 2.2 (one process), Section 4.2 (failure and detection); design.processes.semi_markov for the sampling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.monte_carlo.parallel_runs import JUMPS, DrawTable
from design.processes.elementary import log
from design.processes.semi_markov import FaultDetection, SemiMarkov

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

PAGE = 16
"""Counter values per page of jump draws: 32 jumps of one process."""


class Visits(NamedTuple):
    """One visit of each of some runs: arrays of shape (runs still going,).

    ``run`` counts within the batch; ``mode`` is the plant's, ``seen`` the mode that the gain is scheduled by, ``age_s``
    the reading of the gain's clock at ``start_s``.
    """

    run: IntArray
    mode: IntArray
    seen: IntArray
    age_s: FloatArray
    start_s: FloatArray
    stop_s: FloatArray


def semi_markov_visits(
    process: SemiMarkov, mode: int, duration_s: float, *, seed: int, first: int, runs: int
) -> Iterator[Visits]:
    """Visits up to ``duration_s`` of the runs first, ..., first + runs - 1, all starting in ``mode`` with clock 0."""
    draws = DrawTable(seed, first, runs, purpose=JUMPS, blocks=PAGE)
    run, modes, now = np.arange(runs), np.full(runs, mode, dtype=np.intp), np.zeros(runs)
    jump = 0
    while run.size:
        exponential, uniform = -log(draws.row(2 * jump)), draws.row(2 * jump + 1)
        h, target = process.jump(modes, 0.0, exponential[run], uniform[run])
        then = now + h
        yield Visits(run, modes, modes, np.zeros(run.size), now, np.minimum(then, duration_s))
        going = then < duration_s
        run, modes, now = run[going], target[going], then[going]
        jump += 1


def fault_detection_visits(
    process: FaultDetection,
    failure: int,
    detection: int,
    duration_s: float,
    *,
    seed: int,
    first: int,
    runs: int,
    sees_failure: bool = False,
) -> Iterator[Visits]:
    """Visits of the pair (eta, r): the plant follows eta, the gain follows r and its clock (or both modes).

    At every event both next jumps are drawn anew given the clocks' readings, which leaves the law as it is:
    H(h) - H(a) is Exp(1) given h > a, whatever went before. The earlier one happens.
    """
    draws = DrawTable(seed, first, runs, purpose=JUMPS, blocks=PAGE)
    kinds = process.detection[0].modes
    run, now = np.arange(runs), np.zeros(runs)
    eta, r = np.full(runs, failure, dtype=np.intp), np.full(runs, detection, dtype=np.intp)
    eta_age, r_age = np.zeros(runs), np.zeros(runs)
    event = 0
    while run.size:
        rows = [draws.row(4 * event + k)[run] for k in range(4)]
        eta_h, eta_next = process.failure.jump(eta, eta_age, -log(rows[0]), rows[1])
        r_h, r_next = np.empty(run.size), np.empty(run.size, dtype=np.intp)
        for i, law in enumerate(process.detection):
            here = np.flatnonzero(eta == i)
            r_h[here], r_next[here] = law.jump(r[here], r_age[here], -log(rows[2][here]), rows[3][here])
        # Rounding must not let an event fall before now; with no jump left both are inf.
        to_eta, to_r = np.maximum(eta_h - eta_age, 0.0), np.maximum(r_h - r_age, 0.0)
        step = np.minimum(to_eta, to_r)
        then = now + step
        yield Visits(run, eta, eta * kinds + r if sees_failure else r, r_age, now, np.minimum(then, duration_s))
        going = then < duration_s
        fails = (to_eta <= to_r)[going]
        run, now = run[going], then[going]
        eta_age = np.where(fails, 0.0, (eta_age + step)[going])
        restart = ~fails | process.failure_restarts_detection_clock
        r_age = np.where(restart, 0.0, (r_age + step)[going])
        eta, r = np.where(fails, eta_next[going], eta[going]), np.where(fails, r[going], r_next[going])
        event += 1


ORDER = 10
TILE = 32768
"""Grid points worked on at a time: two states of that many stay in a core's cache."""


def apply(m: FloatArray, x: FloatArray) -> FloatArray:
    """m x for stacks: m of shape (n, n, S), x of shape (n, S)."""
    out: FloatArray = m[:, 0] * x[0]
    for c in range(1, x.shape[0]):
        out += m[:, c] * x[c]
    return out


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """a b for stacks of shape (n, n, S)."""
    out = a[:, 0, None] * b[None, 0]
    for c in range(1, a.shape[0]):
        out += a[:, c, None] * b[None, c]
    return out


def norm_bound(m: FloatArray) -> FloatArray:
    """sqrt(||m||_1 ||m||_inf) >= ||m||_2 for a stack, shape (S,)."""
    size = np.abs(m)
    return np.asarray(np.sqrt(size.sum(axis=0).max(axis=0) * size.sum(axis=1).max(axis=0)))


class MatrixFlow:
    """The flows x -> exp(M_w s) x of a stack of matrices.

    Matrices are stacked with the runs innermost, shape (n, n, W), so that every operation is one numpy call over all runs.
    With a base step b, ||M b|| <= 1/8, and s = j b + r, 0 <= r < b:

        exp(M s) x = prod_{bits k of j} exp(M b 2^k) * (Taylor polynomial of exp(M r), order 10) x

    The remainder of the polynomial is below 3e-18; the powers come from repeated squaring. On the grid s = 0, dt, 2 dt, ...
    the number of known points is doubled in every step, X[L:2L] = exp(M dt L) X[0:L]: log2 of the length numpy calls.
    No eigenvectors are used, so defective and nearly defective matrices lose no digits.

    Args:
        matrices: shape (n, n, W) (1/s).
        dt_s: step of the time grid (s).
        longest_s: no flow lasts longer (s).
    """

    def __init__(self, matrices: FloatArray, *, dt_s: float, longest_s: float) -> None:
        self._m = np.ascontiguousarray(matrices)
        self._states = self._m.shape[0]
        largest = float(norm_bound(self._m).max(initial=0.0))
        # exponent such that dt / 2^halvings is a short enough base step
        self._halvings = int(_levels(np.array(math.ceil(max(largest * dt_s * 8.0, 1.0)))))
        self._base = dt_s / 2**self._halvings
        bits = max(1, math.ceil(longest_s / self._base)).bit_length()
        eye = np.broadcast_to(np.eye(self._states)[:, :, None], self._m.shape)
        power = eye + self._m * (self._base / ORDER)
        for k in range(ORDER - 1, 0, -1):
            power = eye + multiply(self._m, power) * (self._base / k)
        self._powers = [power]
        while len(self._powers) <= bits:
            self._powers.append(multiply(self._powers[-1], self._powers[-1]))

    def flow(self, which: IntArray, x: FloatArray, s: FloatArray) -> FloatArray:
        """exp(M_which s) x: which of shape (S,), x of shape (n, S), s >= 0 of shape (S,)."""
        steps = np.floor(s / self._base).astype(np.int64)
        left = s - steps * self._base
        m = self._m[:, :, which] * left
        term, out = x, x.copy()
        for k in range(1, ORDER + 1):
            term = apply(m, term)
            term /= k
            out += term
        for k in range(int(steps.max(initial=0)).bit_length()):
            on = np.flatnonzero((steps >> k) & 1)
            if on.size:
                out[:, on] = apply(self._powers[k][:, :, which[on]], out[:, on])
        return np.asarray(out)

    def growth(self, which: IntArray, points: IntArray) -> FloatArray:
        """Upper bounds of ||exp(M j dt)|| over j = 0, ..., points - 1, shape (S,).

        From g(2L) <= g(L) max(1, ||exp(M dt L)||), g(1) = 1.
        """
        bound = np.ones(self._m.shape[2])
        table = [bound]
        for k in range(self._halvings, self._halvings + int(points.max(initial=1)).bit_length()):
            bound = bound * np.maximum(1.0, norm_bound(self._powers[k]))
            table.append(bound)
        return np.asarray(np.stack(table)[_levels(points), which])

    def grid(self, which: IntArray, x: FloatArray, points: IntArray) -> Iterator[tuple[IntArray, FloatArray]]:
        """States at 0, dt, 2 dt, ... for segments of different lengths.

        Args:
            which: matrices, shape (S,).
            x: states at the first point, shape (n, S).
            points: how many are wanted, (S,).

        Yields:
            Indices of some segments, shape (s,), and their states, shape (n, L, s), where L is the power of two at or above
            the length of each; what lies beyond a segment's own length is to be ignored. Every segment comes once.
        """
        levels = _levels(points)
        for level in range(int(levels.max(initial=-1)) + 1):
            members = np.flatnonzero((levels == level) & (points > 0))
            width = max(16, TILE >> level)
            for at in range(0, members.size, width):
                index = members[at : at + width]
                yield index, self._double(which[index], x[:, index], level)

    def _double(self, which: IntArray, x: FloatArray, level: int) -> FloatArray:
        n, size = x.shape
        out = np.empty((n, 1 << level, size))
        out[:, 0] = x
        spare = np.empty(((1 << level) // 2, size))
        for k in range(level):
            e, known = self._powers[self._halvings + k][:, :, which], 1 << k
            for r in range(n):
                block = out[r, known : 2 * known]
                np.multiply(out[0, :known], e[r, 0], out=block)
                for c in range(1, n):
                    block += np.multiply(out[c, :known], e[r, c], out=spare[:known])
        return out


def _levels(points: IntArray) -> IntArray:
    """Smallest k with 2^k >= points."""
    mantissa, exponent = np.frexp(np.maximum(points, 1).astype(np.float64))
    return np.asarray(exponent - (mantissa == 0.5), dtype=np.intp)
