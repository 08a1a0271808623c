"""A semi-Markov jump linear closed loop as Monte Carlo sees it, and its exact states at every event and on a grid.

    dx = (A_i + dA_i + (B_i + dB_i) K(i, h)) x = M x,     M constant between events,

where an event is a jump of the process or the end of a section of the scheduled gain. One *segment* is the stretch
between two events; states at the events follow from x(t + s) = exp(M s) x(t) exactly.

The uncertainty is constant in time and drawn per run: norm-bounded with delta = diag(U[-1, 1]) (ERRATA 8),
or uniformly from the hull of the vertices.

A *visit* is a time interval between two jumps. Batches of visits come in order: the k-th batch holds the k-th visit of every run
that is not at its end yet, sampled exactly from one draw of Exp(1) and one of U(0, 1) per jump.

References: thesis Section 2.2; design.processes.semi_markov for the sampling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError
from design.monte_carlo import JUMPS, PARAMETERS, DrawTable, FloatArray, uniforms
from design.processes.elementary import log, product
from design.processes.semi_markov import IntArray, SemiMarkov
from design.semi_markov_loop import JumpSystem, NormBounded, VertexUncertainty

PARAMETER_PAGE = 4
PAGE = 16
"""Counter values per page of jump draws: 32 jumps."""


class Visits(NamedTuple):
    """A stay in a mode from start_s to stop_s of each of some runs: shape (runs still going,); ``run`` counts in the batch."""

    run: IntArray
    mode: IntArray
    start_s: FloatArray
    stop_s: FloatArray


class JumpLoop(Struct, frozen=True, kw_only=True, eq=False):
    """System, gain and process of one closed loop, with its start.

    Args:
        system: N modes, n states.
        gain: scheduled by the mode and the sojourn time (``hold``).
        process: jumps of the mode.
        start: x(0), shape (n,).
        mode: at 0; the clock starts at 0.
        uncertain: draw the system's uncertainty per run, constant in time; otherwise it is left out.
    """

    system: JumpSystem
    gain: ScheduledGain
    process: SemiMarkov
    start: tuple[float, ...]
    mode: int = 0
    uncertain: bool = False

    def __post_init__(self) -> None:
        self.system.check(self.process, self.gain)
        if self.gain.schedule != "hold":
            raise FieldError("gain", "a gain that moves within a section has no exact flow; hold it in small steps")
        start = np.asarray(self.start, dtype=float)
        if start.shape != (self.system.states,) or not np.isfinite(start).all():
            raise FieldError("start", f"{self.start}, expected {self.system.states} finite numbers")
        if not 0 <= self.mode < self.system.modes:
            raise FieldError("mode", f"{self.mode}, expected 0 to {self.system.modes - 1}")
        uncertainty = self.system.uncertainty
        if self.uncertain and uncertainty is None:
            raise FieldError("uncertain", "the system has no uncertainty to draw from")
        if self.uncertain and isinstance(uncertainty, NormBounded) and uncertainty.e.shape[2] != uncertainty.fa.shape[1]:
            size = f"{uncertainty.e.shape[2]} x {uncertainty.fa.shape[1]}"
            raise FieldError("uncertain", f"delta = diag(...) must be square, it is {size}")

    def visits(self, duration_s: float, *, seed: int, first: int, runs: int) -> Iterator[Visits]:
        """Visits up to ``duration_s`` of the runs first, ..., first + runs - 1, each in its own stream."""
        draws = DrawTable(seed, first, runs, purpose=JUMPS, blocks=PAGE)
        run, modes, now = np.arange(runs), np.full(runs, self.mode, dtype=np.intp), np.zeros(runs)
        jump = 0
        while run.size:
            exponential, uniform = -log(draws.row(2 * jump)), draws.row(2 * jump + 1)
            h, target = self.process.jump(modes, 0.0, exponential[run], uniform[run])
            then = now + h
            yield Visits(run, modes, now, np.minimum(then, duration_s))
            going = then < duration_s
            run, modes, now = run[going], target[going], then[going]
            jump += 1

    def matrices(self, *, seed: int, first: int, runs: int) -> FloatArray:
        """M for every (mode, section) and, if uncertain, every run: shape (n, n, W), see ``index``."""
        gain, a, b = self.gain.gain, self.system.a, self.system.b
        nominal = a[:, None] + product(b[:, None], gain)  # (modes, sections, n, n)
        if not self.uncertain:
            return np.ascontiguousarray(np.moveaxis(nominal.reshape(-1, *a.shape[1:]), 0, -1))
        spread = self._directions(gain)  # (parameters, modes, sections, n, n)
        weights = self._weights(spread.shape[0], seed=seed, first=first, runs=runs)
        out = np.repeat(np.moveaxis(nominal, (2, 3), (0, 1))[..., None], runs, axis=-1)
        for direction, weight in zip(spread, weights, strict=True):
            out += np.moveaxis(direction, (2, 3), (0, 1))[..., None] * weight
        return out.reshape(*out.shape[:2], -1)

    def index(self, mode: IntArray, section: int, run: IntArray, runs: int) -> IntArray:
        """Where ``matrices`` holds the matrix of a visit's section."""
        which = mode * self.gain.gain.shape[1] + section
        return np.asarray(which * runs + run if self.uncertain else which)

    def _directions(self, gain: FloatArray) -> FloatArray:
        uncertainty = self.system.uncertainty
        if isinstance(uncertainty, NormBounded):
            shape = uncertainty.fa[:, None] + product(uncertainty.fb[:, None], gain)  # (modes, sections, q, n)
            return np.asarray(np.einsum("imq,igqn->qigmn", uncertainty.e, shape))
        assert isinstance(uncertainty, VertexUncertainty)
        return np.asarray(uncertainty.da[:, :, None] + product(uncertainty.db[:, :, None], gain))

    def _weights(self, parameters: int, *, seed: int, first: int, runs: int) -> FloatArray:
        pages = -(-parameters // (4 * PARAMETER_PAGE))
        drawn = np.concatenate(
            [uniforms(seed, first, runs, blocks=PARAMETER_PAGE, purpose=PARAMETERS, page=page) for page in range(pages)]
        )[:parameters]
        if isinstance(self.system.uncertainty, NormBounded):
            return 2.0 * drawn - 1.0
        share = -log(drawn)  # normalised exponentials are uniform on the simplex
        return np.asarray(share / share.sum(axis=0))


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


class Segments(NamedTuple):
    """Stretches of constant matrix, those of one run in the order of time (not next to each other): shape (S,).

    ``which`` is the matrix; ``x`` (n, S) the state at ``first_s = grid * dt``, the first grid point in the segment;
    ``points`` is the number of grid points in it, which may be 0.
    """

    run: IntArray
    which: IntArray
    grid: IntArray
    points: IntArray
    x: FloatArray


def segments(loop: JumpLoop, flow: MatrixFlow, *, duration_s: float, dt_s: float, seed: int, first: int, runs: int) -> Segments:
    """All segments of a batch with the states at their first grid points."""
    last = round(duration_s / dt_s)
    state = np.repeat(np.asarray(loop.start, dtype=float)[:, None], runs, axis=1)
    parts: list[tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]] = []
    for visits in loop.visits(duration_s, seed=seed, first=first, runs=runs):
        starts = loop.gain.starts_s[visits.mode]  # (S, sections)
        for section in range(starts.shape[1]):
            begin, end = visits.start_s + starts[:, section], visits.stop_s
            if section + 1 < starts.shape[1]:
                end = np.minimum(end, visits.start_s + starts[:, section + 1])
            here = np.flatnonzero(end > begin)
            if not here.size:
                continue
            run, begin, end = visits.run[here], begin[here], end[here]
            which = loop.index(visits.mode[here], section, run, runs)
            before = state[:, run]
            parts.append((run, which, begin, end, before))
            state[:, run] = flow.flow(which, before, end - begin)
    run, which, begin, end = (np.concatenate([part[k] for part in parts]) for k in range(4))
    x = np.concatenate([part[4] for part in parts], axis=1)
    grid = np.ceil(begin / dt_s).astype(np.intp)
    stop = np.where(end >= duration_s, last + 1, np.ceil(end / dt_s).astype(np.intp))
    x = flow.flow(which, x, np.maximum(grid * dt_s - begin, 0.0))
    return Segments(run, which, grid, np.maximum(stop - grid, 0), x)
