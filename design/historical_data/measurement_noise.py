r"""What the controller received is not what the plant was: sensor noise, and a history that no sensor has seen.

Every sample carries one draw v_l(k), which a buffer sends again with the sample; before slot 0 nothing was received. With
Y(k) = (y(k), ..., y(k - tau)), y(k) = x(k) + v(k) from slot 0 on and 0 before, the pair (X, Y) is jump-linear:

.. math:: X(k+1) = \tilde A X(k) + \tilde B K_i Y(k), \qquad P_j(k+1) = \sum_i p_{ij} F_i P_i(k) F_i^T + \pi_j(k+1) W
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
import numpy.typing as npt

from design.errors import NotStable
from design.historical_data.lifted_loop import Array, DelayedPlant, LiftedLoop, close, cycle, with_held
from design.jump_linear.second_moment import forward

SLOTS = 20_000
TOLERANCE = 1e-12

Renewed = npt.NDArray[np.bool_] | None


def close_received(plant: DelayedPlant, gains: Array, transition: Array | None = None, renewed: Renewed = None) -> LiftedLoop:
    """Return the loop on (X, Y), with u = K Y, or on (X, Y, h), with u = K (Y, h).

    Args:
        plant: the plant and its weights.
        gains: (phases, memory + 1, p, n).
        transition: chain of the phases; default the cycle.
        renewed: (phases, n), as of `design.historical_data.lifted_loop.close`.
    """
    phases, columns, p, n = gains.shape
    K = gains.transpose(0, 2, 1, 3).reshape(phases, p, columns * n)
    columns -= renewed is not None
    A, B, weight, input_weight = plant.matrices(max(columns - 1, plant.memory))
    size, received = len(A), columns * n
    F = np.zeros((phases, size + received, size + received))
    F[:, size + n :, size:-n] = np.eye(received - n)
    if renewed is not None:
        F = with_held(F[0], renewed, size + received - n)
    Q = np.zeros_like(F)
    F[:, :size, :size], F[:, :size, size:] = A, B @ K
    F[:, size : size + n] = F[:, :n]
    Q[:, :size, :size], Q[:, size:, size:] = weight, K.transpose(0, 2, 1) @ input_weight @ K
    return LiftedLoop(L=F, Q=Q, transition=cycle(phases) if transition is None else np.asarray(transition, dtype=float))


def cost_from(
    plant: DelayedPlant,
    gains: Array,
    history: npt.ArrayLike,
    phases: Array,
    transition: Array | None = None,
    renewed: Renewed = None,
) -> float:
    """Return J of a stable loop without noise, from a known x(0) and a history that acts on the plant and was not received.

    Args:
        plant: the plant and its weights.
        gains: (phases, memory + 1, p, n).
        history: x(0), x(-1), ..., at most as many as the plant has delayed states and one, (h, n).
        phases: probability of each phase in slot 0.
        transition: chain of the phases; default the cycle.
        renewed: (phases, n), as of `design.historical_data.lifted_loop.close`.

    Raises:
        NotStable: J is infinite.
    """
    loop, known = close_received(plant, gains, transition, renewed), np.asarray(history, dtype=float)
    size, n = loop.L.shape[-1] - gains.shape[1] * gains.shape[3], known.shape[1]
    start = np.zeros(loop.L.shape[-1])
    start[: known.size], start[size : size + n] = known.ravel(), known[0]
    return float(np.einsum("i,a,iab,b->", phases, start, loop.stable_cost_to_go(), start))


def noise_costs(
    plant: DelayedPlant,
    gains: Array,
    deviation: npt.ArrayLike,
    phases: Array,
    transition: Array | None = None,
    renewed: Renewed = None,
) -> Iterator[float]:
    """Yield what the noise adds to E x(k)' Xi x(k) + u(k)' Xi_u u(k) in slot 0, 1, ..., without end.

    Args:
        plant: the plant and its weights.
        gains: (phases, memory + 1, p, n).
        deviation: standard deviation of the noise, one number or one for each state, in its unit; independent over slots.
        phases: probability of each phase in slot 0.
        transition: chain of the phases; default the cycle.
        renewed: (phases, n), as of `design.historical_data.lifted_loop.close`.
    """
    loop, share = close_received(plant, gains, transition, renewed), phases
    fresh = _fresh(plant, gains.shape[1] - (renewed is not None), len(loop.L[0]), deviation)
    P = share[:, None, None] * fresh
    while True:
        yield float(np.einsum("iab,iab->", loop.Q, P))
        share = share @ loop.transition
        P = forward(loop.L, loop.transition, P) + share[:, None, None] * fresh


def stationary_cost(
    plant: DelayedPlant,
    gains: Array,
    deviation: npt.ArrayLike,
    transition: Array | None = None,
    phases: Array | None = None,
    renewed: Renewed = None,
) -> float:
    """Return E x' Xi x + u' Xi_u u per slot, in the mean over time, once the start is forgotten.

    Args:
        plant: the plant and its weights.
        gains: (phases, memory + 1, p, n).
        deviation: standard deviation of the noise, one number or one for each state, in its unit; independent over slots.
        transition: chain of the phases; default the cycle.
        phases: probability of each phase in slot 0, for a chain that does not forget it; default uniform.
        renewed: (phases, n), as of `design.historical_data.lifted_loop.close`.

    Raises:
        NotStable: the covariance grows without end.
    """
    if close(plant, gains, transition, renewed=renewed).radius() >= 1.0:
        raise NotStable("the noise has no stationary covariance: the loop is not stable")
    count = len(gains)
    chain = cycle(count) if transition is None else transition
    start = np.full(count, 1.0 / count) if phases is None else np.asarray(phases, dtype=float)
    share = start @ np.linalg.matrix_power(0.5 * (np.eye(count) + chain), 2**20)  # a lazy chain has the same mean
    before = -np.inf
    every = noise_costs(plant, gains, deviation, share / share.sum(), transition, renewed)
    for k, total in enumerate(islice(every, SLOTS)):
        if total - before <= TOLERANCE * total and k > gains.shape[1] + plant.memory:
            return total
        before = total
    raise NotStable("the covariance of the noise has not settled")


def _fresh(plant: DelayedPlant, columns: int, order: int, deviation: npt.ArrayLike) -> Array:
    """Covariance that a slot's draw adds to (X, Y) of ``columns`` samples, and to what is held beside."""
    n = len(plant.A)
    size = len(plant.matrices(max(columns - 1, plant.memory))[0])
    fresh = np.zeros((order, order))
    fresh[size : size + n, size : size + n] = np.diag(np.broadcast_to(np.asarray(deviation, dtype=float) ** 2, (n,)))
    return fresh
