"""Many runs at once of sensor nodes with random turns: the rig's numbers, bit for bit, in the order in which it adds them.

And over all paths of a random schedule, exact, mean and covariance of the state in every slot."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.controllers import HistoryGains
from design.historical_data import Array, LiftedLoop
from design.jump_linear.second_moment import forward
from hil.rig.loop import Loop
from hil.runtime.nodes import rng_for
from plants.delayed_states import DelayedStates


def states_of_many(loop: Loop, seeds: range, slots: int) -> Array:
    """Return x(k) of every run, (slots, n, runs): gains on the packet of the slot, which comes at once or never.

    Args:
        loop: a delayed plant under gains with ``uses = "current-packet"``, its nodes on one random medium, no delay.
        seeds: one run each.
        slots: how many, slot 0 included.
    """
    plant, controller, nodes = loop.experiment.plant, loop.controller, loop.model.sensors
    assert isinstance(plant, DelayedStates) and isinstance(controller, HistoryGains) and nodes is not None
    assert nodes.turns is not None and nodes.turns.transition and set(nodes.delays) == {0} and not loop.rig.ca_law.age  # type: ignore[attr-defined]
    assert controller.uses == "current-packet" and all(len(own) == 1 for own in nodes.outputs)
    K, turns = controller.history(), nodes.turns
    n, runs = len(plant.A), len(seeds)
    drawn = np.array([rng_for(seed, f"medium.{loop.rig.media[0].name}").random(2 * slots) for seed in seeds])
    rows = [[a for matrix in (plant.A, *plant.delayed) for a in matrix[i]] for i in range(n)]
    past = [np.full(runs, v) for v in (*plant.initial_state, *[0.0] * (n * len(plant.delayed)))]
    shares, matrix = np.cumsum(turns.initial), np.cumsum(turns.transition, axis=1)
    states, node = np.empty((slots, n, runs)), np.zeros(runs, dtype=int)
    for k in range(slots):
        states[k] = past[:n]
        row = np.broadcast_to(shares, (runs, n)) if k == 0 else matrix[node]
        node = np.minimum((drawn[:, 2 * k, None] * row[:, -1:] >= row).sum(axis=1), n - 1)
        received = drawn[:, 2 * k + 1] >= turns.loss
        u = np.zeros(runs)
        for i, own in enumerate(nodes.outputs):
            here, total = received & (node == i), np.zeros(runs)
            for j in range(min(K.shape[1], k + 1)):
                if K[i, j, 0, own[0]] != 0.0:
                    total = total + K[i, j, 0, own[0]] * states[k - j, own[0]].astype(np.float32).astype(float)
            u = np.where(here, total, u)
        u = u.astype(np.float32).astype(float)
        moved = []
        for i in range(n):
            x, forced = np.zeros(runs), plant.B[i][0] * u
            for a, v in zip(rows[i], past):
                x = x + a * v
            moved.append(x + forced)
        past = [*moved, *past[:-n]]
    return states


class StateMoments(NamedTuple):
    """Of x(0), x(1), ...: the mean, (slots, n), and the covariance, (slots, n, n)."""

    mean: Array
    covariance: Array


def state_moments(loop: LiftedLoop, x0: npt.ArrayLike, phases: Array, slots: int) -> StateMoments:
    """Return mean and covariance of the state from a known x(0) with a zero history.

    Args:
        loop: the lifted loop.
        x0: x(0), (n,).
        phases: probability of each phase in slot 0.
        slots: how many slots, slot 0 included.
    """
    x = np.asarray(x0, dtype=float)
    n, size = len(x), loop.L.shape[-1]
    m, S = np.zeros((len(phases), size)), np.zeros((len(phases), size, size))
    m[:, :n], S[:, :n, :n] = phases[:, None] * x, phases[:, None, None] * np.outer(x, x)
    mean, covariance = np.empty((slots, n)), np.empty((slots, n, n))
    for k in range(slots):
        mean[k] = m[:, :n].sum(axis=0)
        covariance[k] = S[:, :n, :n].sum(axis=0) - np.outer(mean[k], mean[k])
        m = loop.transition.T @ np.einsum("iab,ib->ia", loop.L, m)
        S = forward(loop.L, loop.transition, S)
    return StateMoments(mean, covariance)
