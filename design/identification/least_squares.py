"""Plain least squares on differences, for comparison: it is biased as soon as the output carries noise.

    dy(k+1) = a dy(k) + b_1 u(k) + b_2 u(k-1),     p = -ln(a)/T,     g = (b_1 + b_2) p / (T (1 - a))

Reference: thesis sec. 6.2.1; Ljung, System Identification, 1999, sec. 7.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from design.identification.record import Record


def plain_least_squares(records: Sequence[Record]) -> tuple[float, float] | None:
    """Return g and p, None where the fitted a is not between 0 and 1 or the gain not above 0.

    Args:
        records: of one sample period.
    """
    left, right = [], []
    for record in records:
        moved = np.diff(record.y)
        rows = np.column_stack([moved[:-1], record.u[1:-1], record.u[:-2]])
        kept = np.isfinite(rows).all(axis=1) & np.isfinite(moved[1:])
        left.append(rows[kept])
        right.append(moved[1:][kept])
    a, b1, b2 = (float(x) for x in np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=None)[0])
    period_s = records[0].period_s
    if not (0.0 < a < 1.0 and b1 + b2 > 0.0):
        return None
    pole = -math.log(a) / period_s
    return (b1 + b2) * pole / (period_s * (1.0 - a)), pole
