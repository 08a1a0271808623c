"""The performance output z = [Q x; R u1] of the closed loop, or the sum Q x + R u1 that (7.14c) prints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from design.errors import FieldError

Array = npt.NDArray[np.float64]


def performance_output(
    C: Array,
    m: int,
    order: int,
    *,
    Q: npt.ArrayLike | None,
    R: npt.ArrayLike | None,
    output: str,
    input_at: int,
    integral: float,
    integral_at: int,
) -> Array:
    """Weights of the closed-loop state in z(k).

    Args:
        C: (p, n) output matrix, the default of Q.
        m: number of inputs; order: number of closed-loop states.
        Q: (l, n) weight of x, default C.
        R: weight of u1(k-1): (l', m), a vector (one row), or a number (times the
            identity); default the row 0.01 .. 0.01 of Section 7.4.
        output: "stacked" or "sum".
        input_at: first of the m states that R weighs, u1(k-1) of (7.16) or the applied input.
        integral: weight of the integrated error at states `integral_at`.., 0 for none; always stacked.

    DEVIATION: (7.14c) prints the sum. Q x and R u1 may cancel in it, so that large gains look cheap (the VTOL's best
    H-infinity sum has a norm of 2.58 from w to y alone). Stacked is the default, the sum is available.
    """
    n, p = C.shape[1], C.shape[0]
    state_weight = C if Q is None else np.atleast_2d(np.asarray(Q, dtype=np.float64))
    raw = np.asarray(np.full(m, 0.01) if R is None else R, dtype=np.float64)
    input_weight = raw * np.eye(m) if raw.ndim == 0 else np.atleast_2d(raw)
    for name, weight, columns, what in (("Q", state_weight, n, "states"), ("R", input_weight, m, "inputs")):
        if weight.ndim != 2 or weight.shape[1] != columns:
            raise FieldError(name, f"shape {weight.shape}, expected {columns} columns ({what})")
        if not np.isfinite(weight).all():
            raise FieldError(name, "not finite")
    of_state, of_input = np.zeros((state_weight.shape[0], order)), np.zeros((input_weight.shape[0], order))
    of_state[:, :n] = state_weight
    of_input[:, input_at : input_at + m] = input_weight
    if output == "sum":
        if of_state.shape != of_input.shape:
            raise FieldError("output", f"a sum needs as many rows in Q ({len(of_state)}) as in R ({len(of_input)})")
        z = of_state + of_input
    elif output == "stacked":
        z = np.concatenate([of_state, of_input])
    else:
        raise FieldError("output", f"{output!r}, expected 'stacked' or 'sum'")
    if integral > 0:
        accumulated = np.zeros((p, order))
        accumulated[:, integral_at : integral_at + p] = integral * np.eye(p)
        z = np.concatenate([z, accumulated])
    return z
