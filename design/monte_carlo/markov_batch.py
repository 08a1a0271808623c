"""Monte Carlo of discrete-time Markov jump linear systems, thousands of runs per step.

    x(k+1) = A_i x(k) + B_i w(k),    z(k) = C_i x(k) + D_i w(k),    i = theta_k,  Pr{theta_{k+1} = j | i} = p_ij

with w white of unit covariance or zero. Each run has its own streams for the chain and for the noise. Runs of the same
mode are multiplied by their matrix together, in tiles that never reach the size at which a BLAS library begins to use
several threads: so the numbers are the same in every process, whatever its number of threads.

Reference: Chapter 7, (7.14); the Chapter 7 loop is ``loop_structure(...).mjls(gain)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import FieldError
from design.jump_linear import MJLS
from design.monte_carlo import CHAIN, NOISE, ONE_CORE, DrawTable, FloatArray, Workers, in_chunks, inside_chunk
from design.processes.elementary import normal_quantile, product

IntArray = npt.NDArray[np.intp]

CHUNK = 512
PAGE = 64


class MarkovBatch(NamedTuple):
    """What ``simulate_mjls`` returns, R runs, K steps.

    energy: sum_{k<K} |z(k)|^2 per run, (R,). final: x(K), (R, n). peak: max_k |z(k)|, (R,).
    mean: E x(k), (K + 1, n). second: E x(k) x(k)', (K + 1, n, n); both averages over the runs.
    occupancy: share of the runs in each mode, (K + 1, N).
    """

    energy: FloatArray
    peak: FloatArray
    final: FloatArray
    mean: FloatArray
    second: FloatArray
    occupancy: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Task:
    system: MJLS
    start: FloatArray
    initial: FloatArray
    steps: int
    seed: int
    noise: bool
    first: int
    runs: int

    def __call__(self, chunk: int) -> tuple[FloatArray, ...]:
        A, B, C, D, transition = self.system.matrices
        modes, n = A.shape[:2]
        inside = inside_chunk(chunk, self.first, self.runs, CHUNK)
        chain = DrawTable(self.seed, chunk * CHUNK, CHUNK, purpose=CHAIN, blocks=PAGE)
        noise = DrawTable(self.seed, chunk * CHUNK, CHUNK, purpose=NOISE, blocks=PAGE)
        edges = np.cumsum(transition, axis=1)[:, :-1].T  # (N - 1, N): the last target takes what is left
        mode = (chain.row(0) >= np.cumsum(self.initial)[:-1, None]).sum(axis=0)
        x = np.ascontiguousarray(self.start[mode].T)
        energy, peak = np.zeros(CHUNK), np.zeros(CHUNK)
        mean, second = np.empty((self.steps + 1, n)), np.empty((self.steps + 1, n, n))
        occupancy = np.empty((self.steps + 1, modes))
        q = B.shape[2]
        for k in range(self.steps + 1):
            used = x[:, inside]
            mean[k], second[k] = used.sum(axis=1), [(row * used).sum(axis=1) for row in used]
            occupancy[k] = np.bincount(mode[inside], minlength=modes)
            if k == self.steps:
                break
            w = self._noise(noise, k, q) if self.noise else None
            after, z = np.empty_like(x), np.empty((C.shape[1], CHUNK))
            for i in range(modes):
                at = np.flatnonzero(mode == i)
                if not at.size:
                    continue
                here = x[:, at]
                after[:, at], z[:, at] = product(A[i], here), product(C[i], here)
                if w is not None:
                    after[:, at] += product(B[i], w[:, at])
                    z[:, at] += product(D[i], w[:, at])
            square = (z * z).sum(axis=0)
            energy += square
            np.maximum(peak, square, out=peak)
            x = after
            mode = (chain.row(k + 1) >= edges[:, mode]).sum(axis=0)
        return energy[inside], np.sqrt(peak[inside]), x[:, inside].T, mean, second, occupancy

    def _noise(self, table: DrawTable, k: int, q: int) -> FloatArray:
        return normal_quantile(np.stack([table.row(k * q + c) for c in range(q)]))


def simulate_mjls(
    system: MJLS,
    runs: int,
    steps: int,
    *,
    start: npt.ArrayLike,
    initial: npt.ArrayLike | None = None,
    noise: bool = False,
    seed: int = 0,
    first: int = 0,
    workers: Workers = ONE_CORE,
) -> MarkovBatch:
    """Simulate many runs of a jump-linear system, the same numbers for every split.

    Args:
        start: x(0), shape (n,), or per initial mode (N, n).
        initial: distribution of theta_0, uniform if not given.
        noise: w is white with covariance I; otherwise w = 0.
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
    task = _Task(
        system=system,
        start=np.broadcast_to(x0, shape),
        initial=system.alpha(initial),
        steps=steps,
        seed=seed,
        noise=noise,
        first=first,
        runs=runs,
    )
    columns = list(zip(*(part for _, part in in_chunks(task, first, runs, CHUNK, workers)), strict=True))
    energy, peak, final = (np.concatenate(column) for column in columns[:3])
    # Added in the order of the chunks: a sum of floats depends on its order.
    sums = [reduce(np.add, column) / runs for column in columns[3:]]
    return MarkovBatch(energy, peak, final, *sums)
