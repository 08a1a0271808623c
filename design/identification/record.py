"""One recorded experiment on an axis: what was put in, what was measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.errors import DesignError

Array = npt.NDArray[np.float64]

LEAST_SAMPLES = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """Input and output over consecutive slots.

    Args:
        u: input (n,), u[k] held over [k T, (k + 1) T), in the input's unit.
        y: output (n,) at k T, in the output's unit; NaN where a sample is missing.
        period_s: T in s.

    Raises:
        DesignError: the lengths differ, there are too few samples, or an input is missing.
    """

    u: Array
    y: Array
    period_s: float

    def __post_init__(self) -> None:
        u, y = np.array(self.u, dtype=np.float64), np.array(self.y, dtype=np.float64)
        if not (math.isfinite(self.period_s) and self.period_s > 0.0):
            raise DesignError(f"period_s: {self.period_s!r}, expected a finite number above 0")
        if u.ndim != 1 or u.shape != y.shape:
            raise DesignError(f"record: inputs of shape {u.shape} and outputs of shape {y.shape}, expected two equal lengths")
        if not np.isfinite(u).all():
            raise DesignError(f"record: input {int(np.flatnonzero(~np.isfinite(u))[0])} is missing; a fit needs every input")
        if np.isinf(y).any():
            raise DesignError(f"record: output {int(np.flatnonzero(np.isinf(y))[0])} is infinite")
        if int(np.isfinite(y).sum()) < LEAST_SAMPLES:
            raise DesignError(f"record: {int(np.isfinite(y).sum())} outputs, expected at least {LEAST_SAMPLES}")
        object.__setattr__(self, "u", u)
        object.__setattr__(self, "y", y)

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """Which outputs are there (n,)."""
        return np.isfinite(self.y)
