"""The sine by plain operations: that of ``libm`` differs from one processor to the next in the last bit."""

from __future__ import annotations

import math
from typing import Final

TURN: Final = 2.0 * math.pi
"""A full turn in rad."""


def sine(turns: float) -> float:
    """Return sin(2 pi turns), to 2e-16 for what the argument is.

    Args:
        turns: the angle in full turns, finite; in rad over `TURN`.

    >>> sine(0.25), sine(-0.25), sine(1.25)
    (1.0, -1.0, 1.0)
    """
    part = turns % 1.0
    quarter = int(4.0 * part + 0.5)
    x = TURN * (part - 0.25 * quarter)  # at most pi/4, and the difference is exact
    q = x * x
    # Taylor's series, from the term in x^17 (x^16) down, without a loop, which takes twice as long: x^18/18! is below 1e-17.
    if quarter & 1:
        value = 1.0 - q / 240.0
        value = 1.0 - q * value / 182.0
        value = 1.0 - q * value / 132.0
        value = 1.0 - q * value / 90.0
        value = 1.0 - q * value / 56.0
        value = 1.0 - q * value / 30.0
        value = 1.0 - q * value / 12.0
        value = 1.0 - q * value / 2.0
    else:
        value = 1.0 - q / 272.0
        value = 1.0 - q * value / 210.0
        value = 1.0 - q * value / 156.0
        value = 1.0 - q * value / 110.0
        value = 1.0 - q * value / 72.0
        value = 1.0 - q * value / 42.0
        value = 1.0 - q * value / 20.0
        value = x * (1.0 - q * value / 6.0)
    return -value if quarter & 2 else value
