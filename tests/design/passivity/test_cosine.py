"""Sign of a cosine polynomial, against the grid and against polynomials whose sign is known."""

from fractions import Fraction

import numpy as np
import pytest

from design.passivity.condition import is_nonnegative


def minimum(coefficients: list[float]) -> tuple[float, float]:
    """Return the smallest value of a cosine polynomial and the angle in [0, pi] where it is taken, in floats.

    `is_nonnegative` decides it exactly.
    """
    a = np.asarray(coefficients, dtype=np.float64)
    t = np.linspace(0.0, np.pi, 64 * a.size + 1)
    j = np.arange(a.size)

    def value(at: np.ndarray) -> np.ndarray:
        return np.asarray(a @ np.cos(np.outer(j, at)))

    for _ in range(3):
        values = value(t)
        best = int(values.argmin())
        low, high = t[max(best - 1, 0)], t[min(best + 1, t.size - 1)]
        found = float(values[best]), float(t[best])
        t = np.linspace(low, high, 65)
    return found

ONE = Fraction(1)


def square(p):
    """Cosine coefficients of |sum p_j e^(ijt)|^2, which is never negative."""
    n = len(p)
    return [sum(p[i] * p[i + j] for i in range(n - j)) * (1 if j == 0 else 2) for j in range(n)]


@pytest.mark.parametrize("seed", range(12))
def test_a_square_is_nonnegative_and_the_least_below_it_is_not(seed):
    rng = np.random.default_rng(seed)
    squared = square([Fraction(float(x)) for x in rng.normal(size=9)])
    assert is_nonnegative(squared)
    low, _ = minimum([float(c) for c in squared])
    lowered = [squared[0] - Fraction(low) - Fraction(1, 10**6), *squared[1:]]
    assert not is_nonnegative(lowered)
    assert is_nonnegative([squared[0] - Fraction(low) + Fraction(1, 10**6), *squared[1:]])


@pytest.mark.parametrize("order", [1, 2, 5, 8])
def test_fejers_kernel_touches_zero_and_is_decided_without_rounding(order):
    """Double zeros inside: no eigenvalue and no grid distinguishes 0 from -1e-30; whole numbers do."""
    kernel = [Fraction(order), *(Fraction(2 * (order - j)) for j in range(1, order))]
    assert is_nonnegative(kernel)
    assert is_nonnegative([-c for c in kernel]) is False
    if order > 1:
        assert not is_nonnegative([kernel[0] - Fraction(1, 10**30), *kernel[1:]])


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [
        ([0], True),
        ([Fraction(0), Fraction(1)], False),  # cos t
        ([ONE, ONE], True),  # 1 + cos t, zero at pi
        ([ONE, -ONE], True),  # 1 - cos t, zero at 0
        ([ONE / 2, 0, -ONE / 2], True),  # sin^2 t, zeros at 0 and pi
        ([0, ONE * 3 / 4, 0, ONE / 4], False),  # cos^3 t: one triple root inside
        ([-ONE, -ONE], False),
    ],
)
def test_roots_at_the_edges_and_of_odd_multiplicity(coefficients, expected):
    assert is_nonnegative([Fraction(c) for c in coefficients]) is expected
