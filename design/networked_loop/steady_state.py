"""The ideal plant response: state and input at which the output equals the reference, (7.6)-(7.7)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import DesignError

Array = npt.NDArray[np.float64]


class SteadyState(NamedTuple):
    """x* = state @ r and u* = input @ r: Omega_12 (n, p) and Omega_22 (m, p) of (7.7)."""

    state: Array
    input: Array


def steady_state(A: npt.ArrayLike, B: npt.ArrayLike, C: npt.ArrayLike) -> SteadyState:
    """Omega_12 and Omega_22; with more inputs than outputs the solution of least norm, as printed.

    More outputs than inputs cannot follow any reference: there the two hold for the references that `check_held` lets pass.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.

    Raises:
        DesignError: p <= m, and N = [[A - I, B], [C, 0]] has not full row rank; `value` is its smallest singular value.

    >>> steady_state([[0.5]], [[1.0]], [[1.0]]).input.round(9).tolist()
    [[0.5]]
    """
    A_, B_, C_ = (np.asarray(M, dtype=np.float64) for M in (A, B, C))
    n, m, p = A_.shape[0], B_.shape[1], C_.shape[0]
    N = np.block([[A_ - np.eye(n), B_], [C_, np.zeros((p, m))]])
    smallest = float(np.linalg.svd(N, compute_uv=False)[-1])
    if p <= m and smallest < 1e-10 * max(1.0, float(np.abs(N).max())):
        raise DesignError(
            f"steady state: no input holds every reference, [[A - I, B], [C, 0]] has smallest singular value {smallest:.3g}",
            value=smallest,
        )
    right = np.linalg.lstsq(N, np.vstack([np.zeros((n, p)), np.eye(p)]), rcond=None)[0]
    return SteadyState(np.asarray(right[:n]), np.asarray(right[n:]))


def check_held(A: npt.ArrayLike, B: npt.ArrayLike, C: npt.ArrayLike, star: SteadyState, reference: npt.ArrayLike) -> None:
    """Refuse a reference that the ideal response does not hold.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.
        star: of this plant.
        reference: (K, p).

    Raises:
        DesignError: `value` is by how much x* or C x* is off.
    """
    A_, B_, C_, r = (np.asarray(M, dtype=np.float64) for M in (A, B, C, reference))
    x, u = r @ star.state.T, r @ star.input.T
    off = max(float(np.abs(x @ A_.T + u @ B_.T - x).max()), float(np.abs(x @ C_.T - r).max()))
    if off > 1e-8 * max(1.0, float(np.abs(r).max()), float(np.abs(x).max())):
        raise DesignError(f"reference: no input holds it, the steady state misses it by {off:.3g}", value=off)
