r"""Mean and variance of the cost over the runs of a random schedule, from a known start: exact, by fourth moments.

A run costs J = sum of X(k)'Q X(k). With S the cost-to-go, J less its mean is the sum of the increments

.. math:: D(k) = Y^T \Big(S_j - \sum_l p_{il} S_l\Big) Y, \qquad Y = L_i X(k),\ i = i(k),\ j = i(k+1),

each of mean zero given the past, hence uncorrelated. So Var J is the sum over k of E D(k)^2, and that of the first phase:
a quartic form of X(k), whose fourth moments follow the linear recursion

.. math:: Z_j(k+1) = \sum_i p_{ij} (L_i \otimes L_i) Z_i(k) (L_i \otimes L_i)^T, \qquad Z_i = E[(X \otimes X)(X \otimes X)^T; i]

on the symmetric part of X x X, N (N + 1) / 2 numbers. The sum ends where the loop is stable in the fourth moment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import NotStable
from design.historical_data.lifted_loop import Array, LiftedLoop

SLOTS = 5000
SETTLED = 1e-10


class CostMoments(NamedTuple):
    """Of the cost of a run: its mean and its variance."""

    mean: float
    variance: float


def cost_moments(loop: LiftedLoop, x0: npt.ArrayLike, phases: Array) -> CostMoments:
    """Return mean and variance of the cost over all paths, from a known past.

    Args:
        loop: the lifted loop of order N; it takes N^4 numbers a phase.
        x0: x(0), (n,), or x(0), x(-1), ..., (h, n); zero before.
        phases: probability of each phase in slot 0.

    Raises:
        NotStable: the mean or the variance is infinite.
    """
    x, size, P = np.asarray(x0, dtype=float), loop.L.shape[-1], loop.transition
    S = loop.cost_to_go()
    X = np.zeros(size)
    X[: x.size] = x.ravel()
    first = np.einsum("a,iab,b->i", X, S, X)
    mean = float(phases @ first)
    upper = np.triu_indices(size)
    L2 = np.array([_on_pairs(L, upper) for L in loop.L])
    later = np.tensordot(P, S, axes=1)
    forms = [[_form(L.T @ (S[j] - later[i]) @ L, upper) for j in range(len(S))] for i, L in enumerate(loop.L)]
    price = np.array([sum(p * np.outer(f, f) for p, f in zip(P[i], forms[i])) for i in range(len(S))])
    z = X[upper[0]] * X[upper[1]]
    Z = phases[:, None, None] * np.outer(z, z)
    variance = float(phases @ (first - mean) ** 2)
    for _ in range(SLOTS):
        added = float(np.vdot(price, Z))
        variance += added
        if not np.isfinite(variance):
            break
        if added <= SETTLED * variance:
            return CostMoments(mean, variance)
        Z = np.tensordot(P.T, L2 @ Z @ L2.transpose(0, 2, 1), axes=1)
    raise NotStable("the variance of the cost has no finite sum: the loop is not stable in the fourth moment")


def _on_pairs(L: Array, upper: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]) -> Array:
    """Return what takes the products x_a x_b, a <= b, to those of L x."""
    a, b = upper
    found = L[np.ix_(a, a)] * L[np.ix_(b, b)]
    mixed = a != b
    found[:, mixed] += (L[np.ix_(a, b)] * L[np.ix_(b, a)])[:, mixed]
    return np.asarray(found)


def _form(M: Array, upper: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]) -> Array:
    """Return f with f'z = x'Mx for the products z = (x_a x_b), a <= b; M symmetric."""
    a, b = upper
    return np.asarray(M[upper] * np.where(a == b, 1.0, 2.0))
