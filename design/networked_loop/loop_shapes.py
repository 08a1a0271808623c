"""Shapes of what makes a loop, refused by name before anything is computed with them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from design.errors import FieldError

Array = npt.NDArray[np.float64]


def check_gains(gains: npt.ArrayLike, shape: tuple[int, int, int, int], field: str = "gains") -> Array:
    """Return gains as an array of `shape` (sc labels, rows, m, p), or refuse them.

    Raises:
        ValueError: wrong shape or not finite; the message starts with `field`.
    """
    try:
        array = np.array(gains, dtype=np.float64)
    except (TypeError, ValueError):
        raise FieldError(field, f"expected a regular nested list of shape {shape} [tau][row][m][p]") from None
    if array.shape != tuple(shape):
        raise FieldError(field, f"shape {array.shape}, expected {tuple(shape)} [tau][row][m][p]")
    if not np.isfinite(array).all():
        raise FieldError(f"{field}{np.argwhere(~np.isfinite(array))[0].tolist()}", "not finite")
    return array


def check_plant_shapes(A: npt.ArrayLike, B: npt.ArrayLike, C: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Return A (n, n), B (n, m), C (p, n) as arrays.

    Raises:
        ValueError: wrong shape or not finite; the message starts with the matrix's name.
    """
    arrays = []
    for name, value in (("A", A), ("B", B), ("C", C)):
        array = np.asarray(value, dtype=np.float64)
        if array.ndim != 2 or not np.isfinite(array).all():
            raise FieldError(name, f"expected a finite matrix, got shape {array.shape}")
        arrays.append(array)
    A_, B_, C_ = arrays
    n = A_.shape[0]
    if A_.shape != (n, n):
        raise FieldError("A", f"shape {A_.shape}, expected a square matrix")
    if B_.shape[0] != n:
        raise FieldError("B", f"{B_.shape[0]} rows, expected {n}")
    if C_.shape[1] != n:
        raise FieldError("C", f"{C_.shape[1]} columns, expected {n}")
    return A_, B_, C_
