"""Against what a tracking error counts, and over which parts of a run it is judged."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.floating[Any]]

SETTLING_BAND = 0.02
"""Half width of the settling band, as a share of the step."""

SETTLED_SHARE = 0.1
"""Last share of the window that must lie in the band: a run that only crosses the band at its end has not settled."""

STEADY_SHARE = 0.1
"""Last share of the run over which the steady-state error is averaged."""

AFTER_S = 5.0
"""Begin of `sse_after_5s`, session time in s."""


def target_of(reference: Array) -> Array:
    """Return what the error counts against, (n, p): the reference, and before its first change the value that it goes to."""
    target: Array = reference.copy()
    changes = np.flatnonzero(np.any(reference[1:] != reference[:-1], axis=1)) + 1
    if changes.size:
        target[: changes[0]] = reference[changes[0]]
    return target
