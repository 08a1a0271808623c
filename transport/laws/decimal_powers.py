"""Logarithms and powers that are the same on every machine: in decimals, which Python computes with whole numbers.

``libm`` differs from one processor to the next in the last bit. Where that bit could decide, it is asked of `decimal`; where it
cannot, a double is enough, and quicker.
"""

from __future__ import annotations

from decimal import Context, Decimal
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

CLOSE: Final = 1e-12
"""Relative distance below which a number in doubles may be on either side of another: some thousand units in the last place."""

_DIGITS: Final = Context(prec=40, Emin=-(10**6), Emax=10**6)
_EXACT: Final = Context(prec=1200, Emin=-(10**6), Emax=10**6)  # a double has at most 1,074 decimals

_BITS: Final = 43
"""Of a power that are kept. How far one in doubles may be off decides which of them have to be computed in decimals."""


def ln(x: float) -> Decimal:
    """Return ln x to 40 digits, for x > 0."""
    return _DIGITS.ln(Decimal(x))


def ln_complement(u: float) -> Decimal:
    """Return ln(1 - u) to 40 digits, for 0 <= u < 1."""
    return _DIGITS.ln(_EXACT.subtract(Decimal(1), Decimal(u)))


def root(value: Decimal, power: float) -> Decimal:
    """Return value^(1/power) to 40 digits, for a value of at least 0."""
    return _DIGITS.exp(_DIGITS.divide(_DIGITS.ln(value), Decimal(power))) if value else value


def complement_of_power(q: float, order: float, other: float, beta: float) -> float:
    """Return 1 - q^(order^beta - other^beta), for order > other >= 0."""
    first, second = (_DIGITS.exp(_DIGITS.multiply(Decimal(beta), ln(n))) if n else Decimal(0) for n in (order, other))
    return float(_DIGITS.subtract(Decimal(1), _DIGITS.exp(_DIGITS.multiply(ln(q), _DIGITS.subtract(first, second)))))


def whole_powers(base: float, exponents: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return base^n for whole n >= 0, same shape, by squaring."""
    left = np.asarray(exponents, dtype=np.int64).copy()
    out, square = np.ones(left.shape), base
    while left.any():
        out = np.where(left & 1, out * square, out)
        left >>= 1
        square *= square
    return out


def powers(q: float, beta: float, slots: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return q^(n^beta) for whole n >= 0, rounded to 43 bits, same shape.

    Args:
        q: between 0 and 1.
        beta: above 0.
        slots: n.
    """
    n = np.asarray(slots, dtype=np.int64)
    if beta == 1.0:
        return whole_powers(q, n)
    order = n.astype(np.float64) ** beta
    mantissa, exponent = np.frexp(q**order)
    scaled = np.ldexp(mantissa, _BITS)
    off = np.ldexp(4.0 + 4.0 * order * abs(float(ln(q))), _BITS - 53)  # units in the last place, as units of what is kept
    unsure = np.abs(scaled - np.floor(scaled) - 0.5) <= off
    out = np.ldexp(np.rint(scaled), exponent - _BITS)
    for at in zip(*np.nonzero(unsure)):
        out[at] = _rounded(q, beta, int(n[at]))
    return np.asarray(out, dtype=np.float64)


@lru_cache(maxsize=100_000)
def _rounded(q: float, beta: float, n: int) -> float:
    exact = _DIGITS.exp(_DIGITS.multiply(ln(q), _DIGITS.exp(_DIGITS.multiply(Decimal(beta), ln(float(n)))))) if n else Decimal(1)
    _, exponent = np.frexp(float(exact))
    whole = int(_DIGITS.multiply(exact, _DIGITS.power(Decimal(2), _BITS - int(exponent))).to_integral_value())
    return float(np.ldexp(float(whole), int(exponent) - _BITS))
