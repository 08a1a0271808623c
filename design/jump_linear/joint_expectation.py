"""Expectations over two independent chains: one over each in turn, where the matrix of the joint chain is a Kronecker product."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Factors = tuple[Array, Array]


def factors_of(transition: Array) -> Factors:
    """Return the two chains whose joint chain this is, (a, a) and (b, b), the sizes most alike; (1, 1) and itself if none are.

    Args:
        transition: (N, N) row-stochastic, or bounds of such a matrix.

    >>> first, second = factors_of(np.kron([[0.5, 0.5], [0.25, 0.75]], [[0.125, 0.875], [1.0, 0.0]]))
    >>> first.tolist(), second.tolist()
    ([[0.5, 0.5], [0.25, 0.75]], [[0.125, 0.875], [1.0, 0.0]])
    """
    N = len(transition)
    for b in sorted((b for b in range(2, N) if N % b == 0), key=lambda b: b + N // b):
        blocks = transition.reshape(N // b, b, N // b, b)
        first = blocks[:, 0].sum(axis=2)
        k, l = np.unravel_index(first.argmax(), first.shape)
        if first[k, l] > 0.0:
            second = blocks[k, :, l] / first[k, l]
            if np.abs(np.kron(first, second) - transition).max() <= 4.0 * np.finfo(float).eps:
                return first, second
    return np.ones((1, 1)), transition


def transposed_factors(factors: Factors) -> Factors:
    """Return the factors of the transpose."""
    first, second = factors
    return np.ascontiguousarray(first.T), np.ascontiguousarray(second.T)


def mean(factors: Factors, family: Array) -> Array:
    """Return sum_j w_ij Y_j for W = kron(first, second) and a family Y (N, ...)."""
    first, second = factors
    if len(first) == 1:
        return np.asarray((second @ family.reshape(len(family), -1)).reshape(family.shape))
    inner = second @ family.reshape(len(first), len(second), -1)
    return np.asarray((first @ inner.reshape(len(first), -1)).reshape(family.shape))
