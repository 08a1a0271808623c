"""Elementary functions of arrays by plain operations: every entry has the same bits wherever it stands, on every machine.

numpy's own are vectorised: the entries in the body of an array may get another last bit than those in its rest, and another
processor gives yet another. So numbers of a study would depend on how its runs are split.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

LN2: Final = 0.6931471805599453
_LN2_HIGH: Final = 0.693147180369123816490  # of 32 bits: its product with an exponent is exact
_LN2_LOW: Final = 1.90821492927058770002e-10
_ROOT_HALF: Final = 0.7071067811865476
_WHOLE: Final = 64
"""Largest power that is taken by squaring."""


def log(x: npt.ArrayLike) -> FloatArray:
    """Return ln x, for x >= 0; to a unit in the last place or two.

    >>> log([1.0, 0.0]).tolist()
    [0.0, -inf]
    """
    x = np.asarray(x, dtype=float)
    mantissa, exponent = np.frexp(x)
    low = mantissa < _ROOT_HALF
    z = np.where(low, 2.0 * mantissa, mantissa) - 1.0
    found = _log_of_near(z, (exponent - low).astype(float))
    return np.asarray(np.where(x == 0.0, -np.inf, np.where(np.isfinite(x), found, x)))


def _log_of_near(z: FloatArray, exponent: FloatArray | float) -> FloatArray:
    s = z / (2.0 + z)  # ln(1 + z) = 2 (s + s^3/3 + ...)
    q = s * s
    series = np.zeros_like(s)
    for k in range(21, 2, -2):
        series = (series + 1.0 / k) * q
    return np.asarray(exponent * _LN2_HIGH + (exponent * _LN2_LOW + 2.0 * s * (1.0 + series)))


def log1p(x: npt.ArrayLike) -> FloatArray:
    """Return ln(1 + x), for x >= -1."""
    x = np.asarray(x, dtype=float)
    near = np.abs(x) <= 0.29
    return np.asarray(np.where(near, _log_of_near(np.where(near, x, 0.0), 0.0), log(1.0 + x)))


def exp(x: npt.ArrayLike) -> FloatArray:
    """Return e^x.

    >>> exp([0.0, -np.inf]).tolist()
    [1.0, 0.0]
    """
    x = np.asarray(x, dtype=float)
    inside = np.clip(x, -800.0, 800.0)
    whole = np.rint(inside * (1.0 / LN2))
    r = (inside - whole * _LN2_HIGH) - whole * _LN2_LOW
    with np.errstate(over="ignore", under="ignore"):
        found = np.ldexp(1.0 + r * _phi(r), whole.astype(np.int32))
    return np.asarray(np.where(np.isnan(x), x, found))


def _phi(r: FloatArray) -> FloatArray:
    """(e^r - 1)/r for |r| <= 1/2."""
    value = np.ones_like(r)
    for k in range(16, 1, -1):
        value = 1.0 + r * value / k
    return value


def expm1(x: npt.ArrayLike) -> FloatArray:
    """Return e^x - 1."""
    x = np.asarray(x, dtype=float)
    near = np.abs(x) <= 0.5
    inside = np.where(near, x, 0.0)
    return np.asarray(np.where(near, inside * _phi(inside), exp(x) - 1.0))


def power(x: npt.ArrayLike, y: float) -> FloatArray:
    """Return x^y, for x >= 0; relative to |y ln x| to a unit in the last place or two.

    >>> power([0.0, 3.0], 2.0).tolist()
    [0.0, 9.0]
    """
    x = np.asarray(x, dtype=float)
    if y == int(y) and abs(y) <= _WHOLE:
        out, square, left = np.ones_like(x), x, int(abs(y))
        with np.errstate(over="ignore", under="ignore", divide="ignore"):
            while left:
                out = out * square if left & 1 else out
                left >>= 1
                square = square * square if left else square
            return np.asarray(1.0 / out if y < 0.0 else out)
    with np.errstate(invalid="ignore"):
        return exp(y * log(x))


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a @ b of stacks of small matrices, summed in one order: of BLAS a column's last bits depend on where it stands."""
    out = a[..., :, 0, None] * b[..., None, 0, :]
    for k in range(1, a.shape[-1]):
        out = out + a[..., :, k, None] * b[..., None, k, :]
    return np.asarray(out)
