"""What a measure reads in blocks, given as whole arrays."""

from __future__ import annotations

import numpy as np

from hil.measure.signals import Followed
from hil.measure.tracking import tracking_metrics


def followed(t: np.ndarray, y: np.ndarray, r: np.ndarray) -> Followed:
    """Times (n,), outputs and reference (n,) or (n, p) each, as blocks."""
    y, r = (each[:, None] if each.ndim == 1 else each for each in (y, r))
    return Followed(slots=len(t), of=lambda i, j: (t[i:j], y[i:j], r[i:j]))


def tracking_of_arrays(
    t: np.ndarray, y: np.ndarray, r: np.ndarray, u: np.ndarray, period_s: float, *, disturbed_at_s: float | None = None
) -> dict[str, float | None]:
    """`tracking_metrics` of a run in arrays; u: (n,) or (n, m)."""
    return tracking_metrics(followed(t, y, r), [u], period_s, disturbed_at_s=disturbed_at_s)
