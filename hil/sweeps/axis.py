"""The axis of values that are compared: linear, or one on which an outlier does not crush the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CRUSHED = 20.0
"""Largest size above the smallest median size from which a linear axis shows no difference of the smaller ones."""
DECADES = 1e6
"""Largest size beside the one within which an asinh axis is linear, at most: six decades on either side."""


class Axis(NamedTuple):
    """A logarithmic axis, or one that is linear up to a size and logarithmic beyond (asinh), or, with neither, a linear one."""

    log: bool = False
    asinh: float | None = None

    @property
    def note(self) -> str:
        """What a plot says of its axis, nothing of a linear one."""
        if self.asinh is None:
            return "The axis is logarithmic." if self.log else ""
        return f"The axis is linear up to {self.asinh:.2g} on both sides of 0, and logarithmic beyond."


def axis_for(groups: Sequence[NDArray[np.float64]]) -> Axis:
    """Return the axis for some groups of values.

    Args:
        groups: values that are compared; those that are not finite do not count.

    >>> axis_for([np.array([11.0, 12.0]), np.array([350.0])])
    Axis(log=True, asinh=None)
    >>> axis_for([np.array([-0.5, 0.5, 1.0]), np.array([-300.0, 2.0])])
    Axis(log=False, asinh=0.5)
    >>> axis_for([np.array([-1.0, 2.0]), np.array([3.0])])
    Axis(log=False, asinh=None)
    """
    finite = [values[np.isfinite(values)] for values in groups]
    sizes = [np.abs(values) for values in finite if values.size]
    medians = [float(np.median(size)) for size in sizes if size.any()]
    largest = max((float(size.max()) for size in sizes), default=0.0)
    usual = min((median for median in medians if median > 0.0), default=0.0)
    if not 0.0 < CRUSHED * usual < largest:
        return Axis()
    if min(float(values.min()) for values in finite if values.size) > 0.0:
        return Axis(log=True)
    return Axis(asinh=max(usual, largest / DECADES))
