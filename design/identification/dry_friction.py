"""Dry friction that a fit of y'' + p y' = g u leaves: residuals do not show it, for damping takes its place.

A square wave against 2 % of its force leaves white residuals in 98 of 100 fits, and an interval of p that misses in all of them.
So one more term is fitted to what is left, the response to -f sign(v) of the fitted speed v, beside all the sensitivities: f has
the input's unit. What it cannot tell from damping it says by its interval.

Reference: thesis (7.39); a score test: C. R. Rao, Proc. Cambridge Phil. Soc. 44 (1948) 50-57.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from design.identification.axis import Array, Record, forced, held

ALIKE = 1e-6
"""Share of the term, behind the sensitivities, below which it is one of them."""


def dry_friction(
    records: Sequence[Record], gain: float, pole: float, starts: Sequence[tuple[float, float]], left: Array, jacobian: Array
) -> tuple[float, float]:  # fmt: skip
    """Return the dry friction f and its standard error, in the input's unit; 0 and infinity where no record can show it.

    Args:
        records: what was recorded.
        gain, pole, starts: of the fit.
        left: its residuals (n,).
        jacobian: its sensitivities (n, parameters).
    """
    signs = [np.sign(_speed(record, gain, pole, speed)) for record, (_, speed) in zip(records, starts)]
    moved = [forced(sign, pole, record.period_s)[0][record.measured] for record, sign in zip(records, signs)]
    term = -gain * np.concatenate(moved)
    base = np.linalg.qr(jacobian / np.linalg.norm(jacobian, axis=0))[0]
    alone = term - base @ (base.T @ term)
    square, freedom = float(alone @ alone), left.size - jacobian.shape[1] - 1
    if square <= (ALIKE**2) * float(term @ term):
        return 0.0, math.inf
    found = float(alone @ left) / square
    rest = left - found * alone
    return found, math.sqrt(float(rest @ rest) / freedom / square)


def _speed(record: Record, gain: float, pole: float, begin: float) -> Array:
    """Return v(k) (n,): v(k+1) = a v(k) + g s1 u(k)."""
    step = held(pole, record.period_s)
    pushed = np.concatenate(([begin], gain * step.s1 * record.u[:-1]))
    return np.asarray(lfilter([1.0], [1.0, -step.a], pushed))
