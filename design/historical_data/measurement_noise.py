r"""What sensor noise costs in the long run: the stationary mean of x' Xi x under scheduled gains.

Every sample carries one draw v_l(k), which a buffer sends again with the sample. With V(k) = (v(k), ..., v(k - tau)) the pair
(X, V) is a linear system driven by v, and its covariance follows the cycle:

.. math:: X(k+1) = L_i X(k) + \tilde B K_i V(k), \qquad P_{i+1} = F_i P_i F_i^T + W
"""

from __future__ import annotations

import numpy as np

from design.errors import NotStable
from design.historical_data.lifted_loop import Array, DelayedPlant, close

CYCLES = 20_000
TOLERANCE = 1e-12


def stationary_cost(plant: DelayedPlant, gains: Array, deviation: float) -> float:
    """Return E x' Xi x + u' Xi_u u per slot, mean over the phases of a cycle, once the start is forgotten.

    Args:
        plant: the plant and its weights.
        gains: (phases, memory + 1, p, n).
        deviation: standard deviation of the noise on every sample, in the states' unit; independent over states and slots.

    Raises:
        NotStable: the covariance grows without end.
    """
    phases, columns, p, n = gains.shape
    loop = close(plant, gains)
    if loop.radius() >= 1.0:
        raise NotStable("the noise has no stationary covariance: the loop is not stable")
    size, noise = loop.L.shape[-1], columns * n
    B, input_weight = plant.matrices(max(columns - 1, plant.memory))[1], plant.input_weight
    K = gains.transpose(0, 2, 1, 3).reshape(phases, p, noise)
    F = np.zeros((phases, size + noise, size + noise))
    F[:, :size, :size], F[:, :size, size:] = loop.L, B @ K
    F[:, size + n :, size:-n or None] = np.eye(noise - n)
    fresh = np.zeros((size + noise, size + noise))
    fresh[size : size + n, size : size + n] = deviation**2 * np.eye(n)
    heard = np.zeros((phases, p, size + noise))  # u = K (X + V)
    heard[:, :, :noise], heard[:, :, size:] = K, K
    weight = np.zeros_like(fresh)
    weight[:n, :n] = plant.weight
    R = np.zeros((p, p)) if input_weight is None else input_weight
    price = weight + heard.transpose(0, 2, 1) @ R @ heard
    P, before = fresh, np.inf
    for _ in range(CYCLES):
        total = 0.0
        for i in range(phases):
            total += float(np.einsum("ab,ab->", price[i], P)) / phases
            P = F[i] @ P @ F[i].T + fresh
        if abs(total - before) <= TOLERANCE * max(total, before if np.isfinite(before) else 0.0):
            return total
        before = total
    raise NotStable("the covariance of the noise has not settled")
