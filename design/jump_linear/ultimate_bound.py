"""Where a mean-square stable loop ends that bounded signals push: a bound of the root mean square of what is asked for."""

from __future__ import annotations

import numpy as np

from design.errors import NotStable
from design.jump_linear.second_moment import Array, backward, cost_once, expect

SHARE = 1e-3
"""What of a bound may be left to the end of its sum."""
TERMS = 100_000


def ultimate_bound(A: Array, transition: Array, E: Array, C: Array) -> Array:
    r"""Return what the root mean square of C x ends within, the share of each signal, (q,); their sum is the bound.

    It holds for a stable system, whatever the bounded signals are that push it.

    .. math:: x(k+1) = A_i x(k) + \sum_q E_i^q e_q(k), \qquad |e_q(k)| \le 1, \qquad z = C x

    By Minkowski's inequality in the mean square, with M_0 = C'C and M_{t+1} = L M_t, the cost operator of `second_moment`,

    .. math:: \limsup_k \sqrt{E |z(k)|^2} \le \sum_q \sum_t \sqrt{\max_i E_i^{q\prime} (\textstyle\sum_j p_{ij} M_t^j) E_i^q}

    whatever e(k) knows of the modes and states up to slot k. The sum over t is ended where what follows is known to be small:
    with P - L P >= I, L P <= (1 - 1/|P|) P.

    Args:
        A: (N, n, n) mode matrices of a mean-square stable system.
        transition: (N, N) transition probabilities, or upper bounds of them over which it is stable.
        E: (N, n, q), what signals of size 1 push.
        C: (l, n), what is asked for.

    Raises:
        NotStable: so near the edge that no bound was found.
    """
    P = cost_once(A, transition, np.broadcast_to(np.eye(A.shape[-1]), A.shape))
    largest = float(np.linalg.eigvalsh(P)[:, -1].max())
    if not 1.0 <= largest < 1e14 or float(np.linalg.eigvalsh(P)[:, 0].min()) < 1.0 - 1e-6:
        raise NotStable("no bound was found: the loop is too near to one that is not mean-square stable")
    left = np.sqrt(_reached(expect(transition, P), E)) / (1.0 - np.sqrt(max(1.0 - 1.0 / largest, 0.0)))
    M, total = np.broadcast_to(C.T @ C, A.shape), np.zeros(E.shape[-1])
    for _ in range(TERMS):
        total = total + np.sqrt(_reached(expect(transition, M), E))
        M = backward(A, transition, M)
        tail = np.sqrt(max(float(np.linalg.eigvalsh(M)[:, -1].max()), 0.0)) * left
        if (tail <= SHARE * total).all():
            return np.asarray(total + tail)
    raise NotStable("no bound was found: the loop is too near to one that is not mean-square stable")


def _reached(M: Array, E: Array) -> Array:
    """max_i E_i^q' M_i E_i^q, (q,)."""
    return np.asarray(np.maximum(np.einsum("iaq,iab,ibq->iq", E, M, E), 0.0).max(axis=0))
