"""Clarabel, and what its dual matrices prove by weak duality.

It solves min q'x with b - A x in a product of positive semidefinite triangles: upper ones, column by column, off-diagonals times
sqrt(2).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse

from design.errors import solver

FloatArray = npt.NDArray[np.float64]


def triangle(size: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], FloatArray]:
    """Rows, columns and weights of the triangle of a symmetric matrix; the weights keep the inner product."""
    rows, cols = np.tril_indices(size)
    return cols, rows, np.where(rows == cols, 1.0, np.sqrt(2.0))


def excluded(q: FloatArray, a: sparse.csc_matrix, b: FloatArray, sizes: list[int], z: FloatArray) -> float:
    """Weak duality: for Z >= 0 and every admissible x, q'x >= (q + A'z)'x - b'z >= -|q + A'z|_1 max|x| - b'z.

    With q'x = -margin, no margin is positive while max|x| <= -b'z / |q + A'z|_1. Z is the solver's, projected on Z >= 0.
    """
    if not np.isfinite(z).all():
        return 0.0
    projected, top = np.empty_like(z), 0
    for size in sizes:
        r, c, weight = triangle(size)
        matrix = np.zeros((size, size))
        matrix[r, c] = matrix[c, r] = z[top : top + r.size] / weight
        values, vectors = np.linalg.eigh(matrix)
        matrix = (vectors * np.maximum(values, 0.0)) @ vectors.T
        projected[top : top + r.size] = matrix[r, c] * weight
        top += r.size
    return max(0.0, float(-(b @ projected) / max(np.abs(q + a.T @ projected).sum(), 1e-300)))


def clarabel(q: FloatArray, a: sparse.csc_matrix, b: FloatArray, sizes: list[int]) -> tuple[FloatArray, FloatArray, str]:
    """Interior point: x, z and what the solver says of them."""
    package = solver("clarabel")
    settings = package.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 2
    cones = [package.PSDTriangleConeT(size) for size in sizes]
    quadratic = sparse.csc_matrix((q.size, q.size))
    result = package.DefaultSolver(quadratic, q, a, b, cones, settings).solve()
    return np.array(result.x), np.array(result.z), str(result.status)
