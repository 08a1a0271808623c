"""Monte Carlo of discrete-time Markov jump linear systems that nothing drives, thousands of runs per step.

    x(k+1) = A_i x(k),    z(k) = C_i x(k),    i = theta_k,  Pr{theta_{k+1} = j | i} = p_ij

Each run has its own stream for the chain. Runs of the same mode are multiplied by their matrix together, in tiles that never
reach the size at which a BLAS library begins to use several threads: so the numbers are the same in every process, whatever its
number of threads.

Reference: Chapter 7, (7.14); the Chapter 7 loop is ``loop_structure(...).mjls(gain)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.errors import FieldError
from design.jump_linear import MJLS
from design.monte_carlo import CHAIN, ONE_CORE, DrawTable, FloatArray, Workers, in_chunks, inside_chunk
from design.processes.elementary import product

CHUNK = 512
PAGE = 64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Task:
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
        chain = DrawTable(self.seed, chunk * CHUNK, CHUNK, purpose=CHAIN, blocks=PAGE)
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
    task = _Task(
        system=system,
        start=np.broadcast_to(x0, shape),
        initial=system.alpha(initial),
        steps=steps,
        seed=seed,
        first=first,
        runs=runs,
    )
    return np.concatenate([part for _, part in in_chunks(task, first, runs, CHUNK, workers)])
