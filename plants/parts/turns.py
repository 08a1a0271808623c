"""The sine by plain operations: that of ``libm`` differs from one processor to the next in the last bit."""

from __future__ import annotations

import math
from typing import Final

TURN: Final = 2.0 * math.pi
"""A full turn in rad."""

_COSINE: Final = (240.0, 182.0, 132.0, 90.0, 56.0, 30.0, 12.0, 2.0)  # 16 15, 14 13, ...
_SINE: Final = (272.0, 210.0, 156.0, 110.0, 72.0, 42.0, 20.0, 6.0)  # 17 16, 15 14, ...


def sine(turns: float) -> float:
    """Return sin(2 pi turns), to 2e-16 for what the argument is.

    Args:
        turns: the angle in full turns, finite; in rad over `TURN`.

    >>> sine(0.25), sine(0.5), sine(-0.25)
    (1.0, 0.0, -1.0)
    """
    part = turns - math.floor(turns)
    quarter = math.floor(4.0 * part + 0.5)
    x = TURN * (part - 0.25 * quarter)  # at most pi/4, and the difference is exact
    q = x * x
    value = 1.0
    # x^18/18! is below 1e-17
    for k in _COSINE if quarter & 1 else _SINE:
        value = 1.0 - q * value / k
    if not quarter & 1:
        value *= x
    return -value if quarter & 2 else value
