r"""The part of a jump-linear system that its output ever shows.

A predictor that carries a model of an integrator beside the plant has an offset that neither the plant nor the input knows: a
state with factor 1. With the rows of T an orthonormal basis of

.. math:: \operatorname{span} \{ C_{i_0}' ,\ A_{i_1}' C_{i_0}',\ A_{i_2}' A_{i_1}' C_{i_0}',\ \ldots \}

T A_i = A^T_i T, so that z = T x is a jump-linear system of its own with the same output.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from design.jump_linear.mjls import MJLS
from design.jump_linear.second_moment import Array, mean_square_radius

SEEN = 1e-7
"""Share of a direction's size below which it is rounding."""
EXACT = 1e-11
"""What T A_i - A^T_i T may be, as a share of A_i."""
GROWS = 1.0 + 1e-9
"""Second-moment radius from which on what is not seen grows."""


def observed_part(system: MJLS, shown: Array) -> tuple[MJLS, int]:
    """Return the system in the coordinates that its output and more rows show, and how many directions are left out.

    None is left out unless what is left out does not grow by any factor: its second-moment radius is at most 1.

    Args:
        system: the system; C of what has to be stable.
        shown: more of what has to be stable, (l, n).
    """
    A, B, C, _, transition = system.matrices
    n, basis = system.order, np.zeros((0, system.order))
    front = np.vstack([shown, C.reshape(-1, n)])
    while len(front) and len(basis) < n:
        left = front - front @ basis.T @ basis
        left -= left @ basis.T @ basis
        size = np.linalg.norm(front, axis=1, keepdims=True)
        _, s, rows = np.linalg.svd(left / np.where(size > 0.0, size, 1.0), full_matrices=False)
        found = rows[s > SEEN * max(1.0, float(s[0]))]
        basis = np.vstack([basis, found])
        front = (found @ A).reshape(-1, n)
    if len(basis) == n:
        return system, 0
    inner, scale = basis @ A @ basis.T, max(1.0, float(np.abs(A).max()))
    rest = np.linalg.svd(basis)[2][len(basis) :]
    if np.abs(basis @ A - inner @ basis).max() > EXACT * scale or mean_square_radius(rest @ A @ rest.T, transition) > GROWS:
        return system, 0
    return replace(system, A=inner, B=basis @ B, C=C @ basis.T), n - len(basis)
