r"""Mean and covariance of the state in every slot, over all paths of a random schedule: exact.

With m_i(k) = E[X(k) 1{phase i}] and S_i(k) = E[X(k) X(k)' 1{phase i}],

.. math:: m_j(k+1) = \sum_i p_{ij} L_i m_i(k), \qquad S_j(k+1) = \sum_i p_{ij} L_i S_i(k) L_i^T
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.historical_data.lifted_loop import Array, LiftedLoop
from design.jump_linear.second_moment import forward


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
