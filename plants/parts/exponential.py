"""Exponentials that give the same bits on every machine.

A log must have the same SHA-256 wherever it is made. BLAS kernels and ``libm`` differ from one processor to the next
in the last bit, and a plant multiplies that bit by its growth. So everything here uses only what IEEE 754 and integers
fix:

- `zero_order_hold`: the exact discretisation, in 256-bit fixed point, rounded once at the end (for steps that recur);
- `drift`: the same for one step of odd length, as a Taylor series in floats (for the pieces between random events);
- `phi`, `exp`, `log1p`: scalar functions; one exponential segment of a friction model needs the first and the last;
- `phi_many`, `log1p_many`: these two for many numbers at once, each with the bits of the scalar function.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from plants.errors import PlantError

Array = npt.NDArray[np.float64]
Rows = tuple[tuple[float, ...], ...]

_BITS = 256  # of the fraction; each of at most 20 doublings may cost one or two of them
_ONE = 1 << _BITS
_MAX_DOUBLINGS = 24
LN2 = 0.6931471805599453
MOST_HALVINGS = 40
"""Of an argument of `phi`: beyond it is no number of modest size."""


def _fixed(value: float) -> int:
    numerator, denominator = value.as_integer_ratio()
    return (numerator << _BITS) // denominator


def _product(a: list[list[int]], b: list[list[int]]) -> list[list[int]]:
    columns = list(zip(*b))
    return [[sum(x * y for x, y in zip(row, column)) >> _BITS for column in columns] for row in a]


def zero_order_hold(A: Sequence[Sequence[float]], B: Sequence[Sequence[float]], ratio: tuple[int, int]) -> tuple[Rows, Rows]:
    """Discretise x' = A x + B v, with v held over T, without any rounding but the last.

    Phi = exp(A T),  Gamma = int_0^T exp(A s) ds B = T phi_1(A T) B,  phi_1(M) = sum_k M^k / (k+1)!,
    with phi_1(2M) = phi_1(M) (I + exp(M)) / 2 to double the step.

    Args:
        A: n x n, unit 1/s between states.
        B: n x m.
        ratio: T in seconds as numerator and denominator, e.g. ``(50_000_000, 10**9)``.

    Returns:
        Phi (n x n) and Gamma (n x m) as tuples of rows.

    Raises:
        PlantError: where exp(A T) has no representation as a float.

    >>> zero_order_hold([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], (1, 2))
    (((1.0, 0.5), (0.0, 1.0)), ((0.125,), (0.5,)))
    """
    return _zero_order_hold(tuple(map(tuple, A)), tuple(map(tuple, B)), ratio)


@lru_cache(maxsize=64)  # the first slots of a session need what a rig that was run to warm up has computed
def _zero_order_hold(A: Rows, B: Rows, ratio: tuple[int, int]) -> tuple[Rows, Rows]:
    numerator, denominator = ratio
    n = len(A)
    M = [[_fixed(a) * numerator // denominator for a in row] for row in A]
    norm = max((sum(abs(a) for a in row) for row in M), default=0)
    doublings = max(0, norm.bit_length() - _BITS + 2)  # the scaled norm is below 1/4
    if doublings > _MAX_DOUBLINGS:
        found = f"exp(A T): A T has norm 2**{norm.bit_length() - _BITS}, expected less than 2**{_MAX_DOUBLINGS - 2}"
        raise PlantError(f"{found}: a shorter period, or a plant with slower motion")
    M = [[a >> doublings for a in row] for row in M]
    identity = [[_ONE if i == j else 0 for j in range(n)] for i in range(n)]
    phi_1 = [list(row) for row in identity]
    term, k = identity, 1
    while max(abs(a) for row in term for a in row) > 1:  # a floor shift leaves -1 at -1
        k += 1
        term = [[a // k for a in row] for row in _product(term, M)]
        phi_1 = [[a + t for a, t in zip(row, t_row)] for row, t_row in zip(phi_1, term)]
    Phi = [[i + a for i, a in zip(*rows)] for rows in zip(identity, _product(M, phi_1))]
    for _ in range(doublings):
        grown = [[i + a for i, a in zip(*rows)] for rows in zip(identity, Phi)]
        phi_1 = [[a >> 1 for a in row] for row in _product(phi_1, grown)]
        Phi = _product(Phi, Phi)
        if max(abs(a) for row in Phi for a in row).bit_length() > _BITS + 1024:
            raise PlantError("exp(A T): an entry is too large for a float; the plant is unstable and T too long")
    scaled = [[_fixed(b) * numerator // denominator for b in row] for row in B]
    Gamma = _product(phi_1, scaled)
    return _rounded(Phi), _rounded(Gamma)


def _rounded(fixed: list[list[int]]) -> Rows:
    try:
        return tuple(tuple(a / _ONE for a in row) for row in fixed)
    except OverflowError:
        raise PlantError("exp(A T): an entry is too large for a float; the plant is unstable and T too long") from None


def drift(
    A: Rows, norm: float, x: Sequence[float], force: Sequence[float], dt_s: float, slope: Sequence[float] = ()
) -> list[float]:
    """Solve x' = A x + force + slope s over dt_s, for a step whose length will not come again.

    x(t) = x + sum_k d_k t^k / k!,  d_1 = A x + force,  d_2 = A d_1 + slope,  d_k = A d_(k-1).

    Args:
        A: n x n.
        norm: largest row sum of |A| (cuts a long step into pieces on which the series is short).
        x: state at the start, n.
        force: constant part of the forcing, n.
        dt_s: length of the step in seconds.
        slope: rate of the forcing per second, n, or nothing.

    Returns:
        The state at the end; accurate to rounding.
    """
    pieces = max(1, math.ceil(norm * dt_s))
    h = dt_s / pieces
    now = list(x)
    level = list(force)
    for _ in range(pieces):
        term = [(dot(row, now) + f) * h for row, f in zip(A, level)]
        total = [a + t for a, t in zip(now, term)]
        k = 1
        while k < 60:
            k += 1
            scale = h / k
            term = [dot(row, term) * scale for row in A]
            if k == 2 and slope:
                half = 0.5 * h * h
                term = [t + s * half for t, s in zip(term, slope)]
            following = [a + t for a, t in zip(total, term)]
            if following == total:
                break
            total = following
        now = total
        if slope:
            level = [f + s * h for f, s in zip(level, slope)]
    return now


def dot(row: Sequence[float], x: Sequence[float]) -> float:
    """Return 0 + a_1 b_1 + a_2 b_2 + ..., rounded after every step in this order (`sum` rounds otherwise from Python 3.12 on)."""
    total = 0.0
    for a, b in zip(row, x):
        total += a * b
    return total


def phi(x: float) -> tuple[float, float]:
    """Return phi_1(x) = (e^x - 1)/x and phi_2(x) = (phi_1(x) - 1)/x, for any real x, 0 included.

    phi_1(2x) = phi_1(x) (1 + e^x)/2 and phi_2(2x) = (phi_1(x)^2 + 2 phi_2(x))/4: no difference of near numbers.

    >>> phi(0.0)
    (1.0, 0.5)
    """
    halvings = 0
    while not -0.5 <= x <= 0.5:
        x *= 0.5
        halvings += 1
        if halvings > MOST_HALVINGS:
            raise PlantError(f"phi: argument {x * 2.0**halvings!r}, expected a finite number of modest size")
    p2 = 1.0
    for k in (15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3):  # 2 x^14/16! is below 1e-17 for |x| <= 1/2
        p2 = 1.0 + x * p2 / k
    p2 *= 0.5
    p1 = 1.0 + x * p2
    e = 1.0 + x * p1
    for _ in range(halvings):
        p2 = (p1 * p1 + 2.0 * p2) * 0.25
        p1 = p1 * (1.0 + e) * 0.5
        e *= e
    return p1, p2


def exp(x: float) -> float:
    """Return e^x for x of modest size, to a few units in the last place times |x|.

    >>> exp(0.0)
    1.0
    """
    halvings = 0
    while not -0.5 <= x <= 0.5:
        x *= 0.5
        halvings += 1
        if halvings > MOST_HALVINGS:
            raise PlantError(f"exp: argument {x * 2.0**halvings!r}, expected a finite number of modest size")
    value = 1.0 + x * phi(x)[0]
    for _ in range(halvings):
        value *= value
    return value


def log1p(z: float) -> float:
    """Return ln(1 + z) for z > -1, from frexp and 2 artanh(s) = 2 (s + s^3/3 + ...), s = z/(2 + z).

    >>> log1p(0.0)
    0.0
    """
    exponent = 0
    if not -0.3 <= z <= 0.42:
        mantissa, exponent = math.frexp(1.0 + z)
        if mantissa < 0.7071067811865476:
            mantissa *= 2.0
            exponent -= 1
        z = mantissa - 1.0
    s = z / (2.0 + z)
    q = s * s
    series = 0.0
    for k in (21, 19, 17, 15, 13, 11, 9, 7, 5, 3):  # |s| <= 0.18: s^22/23 is below 1e-17
        series = (series + 1.0 / k) * q
    return exponent * LN2 + 2.0 * s * (1.0 + series)


def phi_many(x: Array) -> tuple[Array, Array]:
    """Return what `phi` gives for every x, (N,); NaN where it raises.

    >>> phi_many(np.array([0.0]))
    (array([1.]), array([0.5]))
    """
    halvings = np.zeros(x.shape, dtype=np.intp)
    while (large := ~((x >= -0.5) & (x <= 0.5)) & (halvings <= MOST_HALVINGS)).any():
        x = np.where(large, x * 0.5, x)
        halvings += large
        x = np.where(halvings > MOST_HALVINGS, np.nan, x)
    p2 = np.ones_like(x)
    for k in range(15, 2, -1):
        p2 = 1.0 + x * p2 / k
    p2 *= 0.5
    p1 = 1.0 + x * p2
    e = 1.0 + x * p1
    for done in range(int(halvings.max(initial=0))):
        more = halvings > done
        p2 = np.where(more, (p1 * p1 + 2.0 * p2) * 0.25, p2)
        p1 = np.where(more, p1 * (1.0 + e) * 0.5, p1)
        e = np.where(more, e * e, e)
    return p1, p2


def log1p_many(z: Array) -> Array:
    """Return what `log1p` gives for every z > -1, (N,).

    >>> log1p_many(np.array([0.0]))
    array([0.])
    """
    mantissa, exponent = np.frexp(1.0 + z)
    low = mantissa < 0.7071067811865476
    reduced = np.where(low, mantissa * 2.0, mantissa) - 1.0
    near = (z >= -0.3) & (z <= 0.42)
    s = np.where(near, z, reduced)
    s = s / (2.0 + s)
    q = s * s
    series = np.zeros_like(s)
    for k in range(21, 2, -2):
        series = (series + 1.0 / k) * q
    return np.asarray(np.where(near, 0, exponent - low) * LN2 + 2.0 * s * (1.0 + series))
