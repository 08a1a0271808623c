"""The scalar functions of an exponential segment for many numbers at once, each bit for bit that of `exponential`."""

from __future__ import annotations

import numpy as np

from plants.parts.exponential import LN2, MOST_HALVINGS
from plants.parts.linear import Matrix


def phi_many(x: Matrix) -> tuple[Matrix, Matrix]:
    """Return what `exponential.phi` gives for every x, (N,); NaN where it raises.

    >>> phi_many(np.array([0.0]))
    (array([1.]), array([0.5]))
    """
    halvings = np.zeros(x.shape, dtype=np.intp)
    large = ~((x >= -0.5) & (x <= 0.5))
    while large.any():
        x = np.where(large, x * 0.5, x)
        halvings += large
        x = np.where(halvings > MOST_HALVINGS, np.nan, x)
        large = ~((x >= -0.5) & (x <= 0.5)) & (halvings <= MOST_HALVINGS)
    p2 = np.ones_like(x)
    for k in range(15, 2, -1):
        p2 = 1.0 + x * p2 / k
    p2 *= 0.5
    p1 = 1.0 + x * p2
    e = 1.0 + x * p1
    for done in range(int(halvings.max(initial=0))):
        more = halvings > done
        p2 = np.where(more, (p1 * p1 + 2.0 * p2) * 0.25, p2)
        p1 = np.where(more, p1 * (1.0 + e) * 0.5, p1)
        e = np.where(more, e * e, e)
    return p1, p2


def log1p_many(z: Matrix) -> Matrix:
    """Return what `exponential.log1p` gives for every z > -1, (N,).

    >>> log1p_many(np.array([0.0]))
    array([0.])
    """
    mantissa, exponent = np.frexp(1.0 + z)
    low = mantissa < 0.7071067811865476
    reduced = np.where(low, mantissa * 2.0, mantissa) - 1.0
    near = (z >= -0.3) & (z <= 0.42)
    s = np.where(near, z, reduced)
    s = s / (2.0 + s)
    q = s * s
    series = np.zeros_like(s)
    for k in range(21, 2, -2):
        series = (series + 1.0 / k) * q
    return np.asarray(np.where(near, 0, exponent - low) * LN2 + 2.0 * s * (1.0 + series))
