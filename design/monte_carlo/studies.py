"""Monte Carlo of jump linear loops, thousands of runs at once: semi-Markov ones, exact between events, and discrete ones.

    settling_times   T_s of (2.28) per run       mean_states   E x(t) on a grid       trajectories   for plots
    mjls_energies    sum of |z(k)|^2 per run of x(k+1) = A_i x(k), z(k) = C_i x(k), i = theta_k a Markov chain

Every run has its own streams of random numbers, and the runs are computed in chunks that are always cut at the same places (see
`design.monte_carlo`), so the numbers do not depend on how the work is split.

References: thesis Section 2.5 and (2.28), (7.14); ERRATA 5 and 8.
"""

from __future__ import annotations

import math
from functools import partial, reduce

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.errors import FieldError, check_above_zero
from design.jump_linear import MJLS
from design.monte_carlo import CHAIN, ONE_CORE, DrawTable, FloatArray, Workers, in_chunks, inside_chunk
from design.monte_carlo.jump_loop import JumpLoop, MatrixFlow, Segments, segments
from design.processes.elementary import product

CHUNK = 1024
"""Runs computed together. Part of the definition of the result's last bits: change it and they may change."""


class _Study(Struct, frozen=True, kw_only=True, eq=False):
    """What one chunk needs to know; it travels to the workers."""

    loop: JumpLoop
    duration_s: float
    dt_s: float
    seed: int
    band: float = 0.0

    def __post_init__(self) -> None:
        check_above_zero(duration_s=self.duration_s, dt_s=self.dt_s)
        if abs(self.duration_s / self.dt_s - self.steps) > 1e-9 * self.steps or self.steps < 1:
            raise FieldError("duration_s", f"{self.duration_s!r} is no multiple of dt_s = {self.dt_s!r}")
        if self.seed < 0:
            raise FieldError("seed", f"{self.seed} is negative")

    @property
    def steps(self) -> int:
        return round(self.duration_s / self.dt_s)

    def solve(self, chunk: int) -> tuple[MatrixFlow, Segments]:
        first = chunk * CHUNK
        matrices = self.loop.matrices(seed=self.seed, first=first, runs=CHUNK)
        flow = MatrixFlow(matrices, dt_s=self.dt_s, longest_s=self.duration_s)
        return flow, segments(
            self.loop, flow, duration_s=self.duration_s, dt_s=self.dt_s, seed=self.seed, first=first, runs=CHUNK
        )

    def settle(self, chunk: int) -> FloatArray:
        """T_s of every run of a chunk, ``inf`` where the last grid point is outside the band."""
        flow, found = self.solve(chunk)
        limit = self.band * self.band * math.fsum(x * x for x in self.loop.start)
        size = (found.x * found.x).sum(axis=0)
        has = found.points > 0
        # A segment matters only if no later one begins outside the band, and if it can leave the band at all.
        last_out = np.full(CHUNK, -1, dtype=np.intp)
        outside = has & ~(size <= limit)
        np.maximum.at(last_out, found.run[outside], found.grid[outside])
        has &= found.grid >= last_out[found.run]
        bound = flow.growth(found.which, found.points)
        has &= ~(bound * bound * size * (1.0 + 1e-9) <= limit)
        index = np.flatnonzero(has)
        last = last_out.copy()
        points = found.points[index]
        for part, x in flow.grid(found.which[index], found.x[:, index], points):
            norm = x[0] * x[0]
            for row in x[1:]:
                norm += row * row
            count = np.arange(1, x.shape[1] + 1, dtype=np.int32)[:, None]
            out = ~(norm <= limit) & (count <= points[part].astype(np.int32))
            steps = (out * count).max(axis=0) - 1
            left = steps >= 0
            chosen = index[part[left]]
            np.maximum.at(last, found.run[chosen], found.grid[chosen] + steps[left])
        return np.where(last < self.steps, (last + 1) * self.dt_s, np.inf)

    def states(self, chunk: int) -> FloatArray:
        """x on the grid, shape (n, grid points, runs of the chunk)."""
        flow, found = self.solve(chunk)
        n = found.x.shape[0]
        out = np.empty((n, CHUNK, self.steps + 1))
        flat = out.reshape(n, -1)
        origin = found.run * (self.steps + 1) + found.grid
        for part, x in flow.grid(found.which, found.x, found.points):
            step = np.arange(x.shape[1])
            real = step < found.points[part][:, None]
            at = (origin[part][:, None] + step)[real]
            for row in range(n):
                flat[row, at] = x[row].T[real]
        return out


def settling_times(
    loop: JumpLoop,
    runs: int,
    *,
    duration_s: float,
    dt_s: float = 0.01,
    band: float = 0.015,
    seed: int = 0,
    first: int = 0,
    workers: Workers = ONE_CORE,
) -> FloatArray:
    """Settling times (2.28): the first grid time from which on |x(t)|_2 <= band |x(0)|_2 up to the end.

    The states are exact at every grid point. Segments that provably stay inside the band are not evaluated.

    Args:
        runs: how many, numbered from ``first``.
        duration_s: length of a run (s), a multiple of the grid's dt_s (s).

    Returns:
        T_s (s), shape (runs,); ``inf`` where the last grid point is outside the band.

    Raises:
        ValueError: an argument that cannot be (the message starts with its name).
    """
    if not band > 0:
        raise FieldError("band", f"{band!r} is not positive")
    study = _Study(loop=loop, duration_s=duration_s, dt_s=dt_s, seed=seed, band=band)
    return np.concatenate([part[inside] for inside, part in in_chunks(study.settle, first, runs, CHUNK, workers)])


def trajectories(
    loop: JumpLoop, runs: int, *, duration_s: float, dt_s: float = 0.01, seed: int = 0, first: int = 0
) -> FloatArray:
    """Exact states on the grid 0, dt_s, ..., duration_s: shape (runs, grid points, n)."""
    study = _Study(loop=loop, duration_s=duration_s, dt_s=dt_s, seed=seed)
    return np.concatenate([x[:, inside].transpose(1, 2, 0) for inside, x in in_chunks(study.states, first, runs, CHUNK)])


def _sum_over_runs(study: _Study, runs: int, chunk: int) -> FloatArray:
    return np.asarray(study.states(chunk)[:, inside_chunk(chunk, 0, runs, CHUNK)].sum(axis=1))


def mean_states(
    loop: JumpLoop,
    runs: int,
    *,
    duration_s: float,
    dt_s: float = 0.01,
    seed: int = 0,
    workers: Workers = ONE_CORE,
) -> FloatArray:
    """Average trajectory E x on the grid (Figure 2.4a), shape (grid points, n); arguments as ``settling_times``."""
    study = _Study(loop=loop, duration_s=duration_s, dt_s=dt_s, seed=seed)
    parts = [part for _, part in in_chunks(partial(_sum_over_runs, study, runs), 0, runs, CHUNK, workers)]
    # Added in the order of the chunks: a sum of floats depends on its order.
    mean: FloatArray = reduce(np.add, parts) / runs
    return mean.T


CHAIN_BLOCKS = 64
"""Blocks of random numbers of a chain that are drawn at once."""


class _ChainEnergies(Struct, frozen=True, kw_only=True, eq=False):
    """What one chunk of `mjls_energies` needs to know, and how it computes them; it travels to the workers."""

    system: MJLS
    start: FloatArray
    initial: FloatArray
    steps: int
    seed: int
    first: int
    runs: int

    def __call__(self, chunk: int) -> FloatArray:
        A, _, C, _, transition = self.system.matrices
        inside = inside_chunk(chunk, self.first, self.runs, CHUNK)
        chain = DrawTable(self.seed, chunk * CHUNK, CHUNK, purpose=CHAIN, blocks=CHAIN_BLOCKS)
        edges = np.cumsum(transition, axis=1)[:, :-1].T  # (N - 1, N): the last target takes what is left
        mode = (chain.row(0) >= np.cumsum(self.initial)[:-1, None]).sum(axis=0)
        x = np.ascontiguousarray(self.start[mode].T)
        energy = np.zeros(CHUNK)
        for k in range(self.steps):
            after, z = np.empty_like(x), np.empty((C.shape[1], CHUNK))
            for i in range(len(A)):
                at = np.flatnonzero(mode == i)
                if not at.size:
                    continue
                here = x[:, at]
                after[:, at], z[:, at] = product(A[i], here), product(C[i], here)
            energy += (z * z).sum(axis=0)
            x = after
            mode = (chain.row(k + 1) >= edges[:, mode]).sum(axis=0)
        return energy[inside]


def mjls_energies(
    system: MJLS,
    runs: int,
    steps: int,
    *,
    start: npt.ArrayLike,
    initial: npt.ArrayLike | None = None,
    seed: int = 0,
    first: int = 0,
    workers: Workers = ONE_CORE,
) -> FloatArray:
    """Return the sum of |z(k)|^2 over k < K of many runs of a jump-linear system, (runs,), the same numbers for every split.

    Args:
        start: x(0), shape (n,), or per initial mode (N, n).
        initial: distribution of theta_0, uniform if not given.
        runs, first, seed: which runs.
        steps: K.

    Raises:
        ValueError: an argument that cannot be (the message starts with its name).
    """
    if steps < 1:
        raise FieldError("steps", f"{steps}, expected at least 1")
    if seed < 0:
        raise FieldError("seed", f"{seed} is negative")
    x0 = np.asarray(start, dtype=float)
    shape = (system.modes, system.order)
    if x0.shape not in (shape, shape[1:]) or not np.isfinite(x0).all():
        raise FieldError("start", f"expected finite numbers of shape {shape[1:]} or {shape}, got shape {x0.shape}")
    energies = _ChainEnergies(
        system=system,
        start=np.broadcast_to(x0, shape),
        initial=system.alpha(initial),
        steps=steps,
        seed=seed,
        first=first,
        runs=runs,
    )
    return np.concatenate([part for _, part in in_chunks(energies, first, runs, CHUNK, workers)])
