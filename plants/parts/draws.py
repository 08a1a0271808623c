"""Random draws, and the sine, that give the same bits on every machine.

numpy's own normal and exponential draws ask ``libm`` for logarithms and exponentials, whose last bit differs from one processor
to the next. Here a draw is a quantile of a uniform number, by +, -, *, / and the square root alone, which IEEE 754 fixes.

Reference: Wichura, Algorithm AS 241 (PPND16), Applied Statistics 37 (1988), relative accuracy 1e-16.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from plants.parts.exponential import log1p

Coefficients = tuple[Sequence[float], Sequence[float]]

BLOCK: Final = 512
"""Uniform numbers drawn at once; the quantile of each is computed when it is asked for: of all it takes 80 us of one slot."""

_CENTRE: Final[Coefficients] = (
    (2509.0809287301227, 33430.57558358813, 67265.7709270087, 45921.95393154987,
     13731.69376550946, 1971.5909503065513, 133.14166789178438, 3.3871328727963665),
    (5226.495278852854, 28729.085735721943, 39307.89580009271, 21213.794301586597,
     5394.196021424751, 687.1870074920579, 42.31333070160091, 1.0),
)  # fmt: skip
_MIDDLE: Final[Coefficients] = (
    (0.0007745450142783414, 0.022723844989269184, 0.2417807251774506, 1.2704582524523684,
     3.6478483247632045, 5.769497221460691, 4.630337846156546, 1.4234371107496835),
    (1.0507500716444169e-09, 0.0005475938084995345, 0.015198666563616457, 0.14810397642748008,
     0.6897673349851, 1.6763848301838038, 2.053191626637759, 1.0),
)  # fmt: skip
_TAIL: Final[Coefficients] = (
    (2.0103343992922881e-07, 2.7115555687434876e-05, 0.0012426609473880784, 0.026532189526576124,
     0.29656057182850487, 1.7848265399172913, 5.463784911164114, 6.657904643501103),
    (2.0442631033899397e-15, 1.421511758316446e-07, 1.8463183175100548e-05, 0.0007868691311456133,
     0.014875361290850615, 0.1369298809227358, 0.599832206555888, 1.0),
)  # fmt: skip


def _ratio(of: Coefficients, r: float) -> float:
    above, below = of[0][0], of[1][0]
    for a, b in zip(of[0][1:], of[1][1:]):
        above = above * r + a
        below = below * r + b
    return above / below


def normal_quantile(p: float) -> float:
    """Return z with Pr(Z < z) = p of a standard normal Z, for every 0 < p < 1 that is a multiple of 2^-53.

    >>> round(normal_quantile(0.5), 12), round(normal_quantile(0.975), 12)
    (0.0, 1.95996398454)
    """
    q = p - 0.5
    if -0.425 <= q <= 0.425:
        return q * _ratio(_CENTRE, 0.180625 - q * q)
    r = math.sqrt(-log1p(min(p, 1.0 - p) - 1.0))
    size = _ratio(_MIDDLE, r - 1.6) if r <= 5.0 else _ratio(_TAIL, r - 5.0)
    return -size if q < 0.0 else size


class Normals:
    """Standard normal draws from a generator, one a call.

    Args:
        rng: asked for `BLOCK` uniform numbers at a time.
    """

    __slots__ = ("_left", "_rng")

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._left: list[float] = []

    def __call__(self) -> float:
        """Return the next draw."""
        if not self._left:
            # 52 bits and a half: never 0 and never 1, and as many below a half as above
            uniform = (np.floor(self._rng.random(BLOCK) * 2.0**52) + 0.5) * 2.0**-52
            self._left = uniform.tolist()
        return normal_quantile(self._left.pop())

    def several(self, size: int) -> list[float]:
        """Return the next ``size`` draws."""
        return [self() for _ in range(size)]


def exponential(rng: np.random.Generator) -> float:
    """Return a draw of the exponential law of mean 1.

    Args:
        rng: asked for one uniform number.
    """
    return -log1p(-float(rng.random()))


TURN: Final = 2.0 * math.pi
"""A full turn in rad."""

# Taylor's series, from the term in x^17 (x^16) down: x^18/18! is below 1e-17.
_SINE: Final = (272.0, 210.0, 156.0, 110.0, 72.0, 42.0, 20.0, 6.0)
_COSINE: Final = (240.0, 182.0, 132.0, 90.0, 56.0, 30.0, 12.0, 2.0)


def sine(turns: float) -> float:
    """Return sin(2 pi turns), to 2e-16 for what the argument is.

    That of ``libm`` differs from one processor to the next in the last bit.

    Args:
        turns: the angle in full turns, finite; in rad over `TURN`.

    >>> sine(0.25), sine(-0.25), sine(1.25)
    (1.0, -1.0, 1.0)
    """
    part = turns % 1.0
    quarter = int(4.0 * part + 0.5)
    x = TURN * (part - 0.25 * quarter)  # at most pi/4, and the difference is exact
    q = x * x
    value = 1.0
    for factor in _COSINE if quarter & 1 else _SINE:
        value = 1.0 - q * value / factor
    if not quarter & 1:
        value *= x
    return -value if quarter & 2 else value
