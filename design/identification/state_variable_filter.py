"""State-variable filter: derivatives of filtered signals instead of differences, the start of a fit.

With L = l^2/(s + l)^2 and y'' = -p y' + g u it holds that s^2 L y = -p (s L y) + g (L u), up to what decays with exp(-l t).

References: Young, Parameter estimation for continuous-time models, 1981; Garnier and Wang (eds.), Identification of
Continuous-time Models from Sampled Data, 2008, ch. 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.signal import cont2discrete, lfilter

from design.identification.axis import Array
from design.identification.record import Record

SKIPPED = 8.0
"""Time constants of the filter after which its own start no longer counts."""


def state_variable_filter(records: Sequence[Record], cutoff: float) -> tuple[float, float] | None:
    """Return g and p by least squares on filtered signals; None where too little is left or the gain is not above 0.

    The output counts as a straight line between its samples, missing ones too; the input as held.

    Args:
        records: what was recorded.
        cutoff: l in 1/s, above the poles that matter and below 1/T.
    """
    left, right = [], []
    for record in records:
        kept = record.measured
        index = np.arange(record.y.size)
        y = np.interp(index, index[kept], record.y[kept])
        y = y - y[0]
        first = int(SKIPPED / (cutoff * record.period_s)) + 1
        if y.size - first < 10:
            continue
        slow = _filtered(y, cutoff, record.period_s, "foh", 1)
        fast = _filtered(y, cutoff, record.period_s, "foh", 2)
        held = _filtered(record.u, cutoff, record.period_s, "zoh", 0)
        left.append(np.column_stack([-slow, held])[first:])
        right.append(fast[first:])
    if not left:
        return None
    pole, gain = (float(x) for x in np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=None)[0])
    return (gain, pole) if gain > 0.0 and np.isfinite(pole) else None


def _filtered(signal: Array, cutoff: float, period_s: float, hold: Literal["foh", "zoh"], power: int) -> Array:
    """Return s^power l^2/(s + l)^2 of a signal."""
    numerator = np.array([cutoff * cutoff] + [0.0] * power)
    b, a, _ = cont2discrete((numerator, np.array([1.0, 2.0 * cutoff, cutoff * cutoff])), period_s, method=hold)
    return np.asarray(lfilter(np.ravel(b), np.ravel(a), signal))
