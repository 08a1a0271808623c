"""A quadratic form that grows while the mode stays: refuses sampled loops whose second moments are too large to compute.

While the mode of the plant stays i, xi_k+1 = F_s xi_k, whichever gain K_s the controller holds. If a symmetric W, of any sign,
and a rho > 1 fulfil

    F_s' W F_s - rho W > 0  for every gain,        x' W_xx x > 0  for some x,

then xi_k' W xi_k >= rho^k xi_0' W xi_0 on those paths. Their probability is at least e^(-Lambda_i k T), Lambda_i the largest
rate out of mode i at any sojourn time, so that E |xi_k|^2 grows at least like (rho e^(-Lambda_i T))^k.

W solves F' W F - rho W = Q for the mean of the gains; it is checked for each of them by eigenvalues.

Reference: Chetaev's theorem on instability.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm, solve_discrete_lyapunov

from design.semi_markov_loop.sojourn_renewal import SampledLoop

FloatArray = npt.NDArray[np.float64]
STATES = 500
"""Most states with delayed inputs for which W is computed."""
_MARGIN = 0.05
_LARGEST = 1e8
_SHARES = (0.9, 0.5, 0.1)
_INPUT_WEIGHTS = (1e-3, 1e-1)


def growth_while_it_stays(loop: SampledLoop, mode: int, gains: Sequence[FloatArray], exit_rate: float) -> float:
    """A lower bound of the growth of E|xi|^2 per period, 0 where none above 1 is proved.

    Args:
        loop: matrices, period and delays.
        mode: i, the mode of the plant that stays.
        gains: every K_s that the controller may hold meanwhile, each of shape (m, n).
        exit_rate: Lambda_i (1/s).
    """
    if loop.size > STATES or not math.isfinite(exit_rate):
        return 0.0
    maps = [period_map(loop, mode, gain) for gain in gains]
    mean = period_map(loop, mode, np.mean(gains, axis=0))
    fastest, leave = float(np.abs(np.linalg.eigvals(mean)).max() ** 2), math.exp(exit_rate * loop.period_s)
    for share in _SHARES:
        rho = leave * (fastest / leave) ** share
        if rho <= leave:
            break
        if any(_grows(maps, mean, rho, loop.system.states, weight) for weight in _INPUT_WEIGHTS):
            return float(rho / leave)
    return 0.0


def period_map(loop: SampledLoop, mode: int, gain: FloatArray) -> FloatArray:
    """F, from xi = (x, v_-1, ..., v_-D) to xi one period later while the mode stays, shape (size, size)."""
    n, m, size = loop.system.states, loop.system.inputs, loop.size
    generator = np.zeros((n + m, n + m))
    generator[:n, :n], generator[:n, n:] = loop.system.a[mode], loop.system.b[mode]
    flow = expm(generator * loop.period_s)
    out = np.zeros((size, size + m))
    out[:n, :n], out[:n, size:] = flow[:n, :n], flow[:n, n:]
    out[n:, n:size] = np.eye(size - n)
    return np.asarray(out @ loop.sampled_at(gain))


def _grows(maps: Sequence[FloatArray], mean: FloatArray, rho: float, states: int, input_weight: float) -> bool:
    weights = np.concatenate([np.ones(states), np.full(mean.shape[0] - states, input_weight)])
    scaled = mean.T / math.sqrt(rho)
    W = solve_discrete_lyapunov(scaled, -np.diag(weights) / rho, method="bilinear")
    if not np.isfinite(W).all() or np.abs(W).max() > _LARGEST:
        return False
    W = 0.5 * (W + W.T)
    unit = 1.0 / np.sqrt(weights)
    rises = [np.linalg.eigvalsh(unit[:, None] * (F.T @ W @ F - rho * W) * unit)[0] for F in maps]
    return bool(min(rises) > _MARGIN and np.linalg.eigvalsh(W[:states, :states])[-1] > _MARGIN)
