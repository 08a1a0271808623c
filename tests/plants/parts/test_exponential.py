"""The exponentials that every plant moves by."""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.errors import PlantError
from plants.parts.exponential import drift, log1p, phi, zero_order_hold

entry = st.floats(-20, 20, allow_subnormal=False)


@st.composite
def systems(draw):
    n, m = draw(st.integers(1, 4)), draw(st.integers(1, 2))
    A = [[draw(entry) for _ in range(n)] for _ in range(n)]
    B = [[draw(entry) for _ in range(m)] for _ in range(n)]
    return A, B


@settings(deadline=None, max_examples=60)
@given(systems(), st.integers(1, 1_000_000_000))
def test_zero_order_hold_is_the_block_matrix_exponential(system, dt_ns):
    A, B = system
    n, m = len(A), len(B[0])
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    expected = scipy.linalg.expm(block * (dt_ns * 1e-9))
    Phi, Gamma = zero_order_hold(A, B, (dt_ns, 10**9))
    scale = np.abs(expected).max()
    assert np.abs(np.array(Phi) - expected[:n, :n]).max() <= 1e-9 * scale
    assert np.abs(np.array(Gamma) - expected[:n, n:]).max() <= 1e-9 * scale


def test_zero_order_hold_is_rounded_once():
    """Against a Taylor series in rational arithmetic: every entry is the nearest float."""
    pole, gain, T = 3.5287, 172.38, Fraction(1, 20)
    x = -Fraction(pole) * T
    phi_1 = sum(x**k / math.factorial(k + 1) for k in range(60))
    phi_2 = sum(x**k / math.factorial(k + 2) for k in range(60))
    Phi, Gamma = zero_order_hold([[0.0, 1.0], [0.0, -pole]], [[0.0], [gain]], (1, 20))
    assert Phi == ((1.0, float(T * phi_1)), (0.0, float(1 + x * phi_1)))
    assert Gamma == ((float(Fraction(gain) * T * T * phi_2),), (float(Fraction(gain) * T * phi_1),))


def test_zero_order_hold_survives_a_day_of_a_stable_plant():
    Phi, Gamma = zero_order_hold([[-3.0]], [[1.0]], (86_400, 1))
    assert Phi == ((0.0,),)
    assert Gamma == ((1 / 3,),)


@pytest.mark.parametrize(("a", "seconds"), [(10.0, 1000), (1e9, 1)])
def test_zero_order_hold_refuses_what_no_float_can_hold(a, seconds):
    with pytest.raises(PlantError, match=r"exp\(A T\)"):
        zero_order_hold([[a]], [[1.0]], (seconds, 1))


@settings(deadline=None, max_examples=60)
@given(systems(), st.integers(0, 300_000_000))
def test_drift_equals_the_hold_matrices(system, dt_ns):
    A, B = system
    x = [1.0 + i for i in range(len(A))]
    v = [0.5] * len(B[0])
    norm = max(sum(abs(a) for a in row) for row in A)
    Phi, Gamma = zero_order_hold(A, B, (dt_ns, 10**9))
    expected = np.array(Phi) @ x + np.array(Gamma) @ v
    force = (np.array(B) @ v).tolist()
    got = drift(tuple(map(tuple, A)), norm, x, force, dt_ns * 1e-9)
    scale = max(np.abs(expected).max(), np.abs(Phi).max() * max(x), np.abs(Gamma).max())
    assert np.abs(np.array(got) - expected).max() <= 1e-12 * scale


def test_drift_follows_a_forcing_that_ramps():
    # x' = -2 x + 1 + 3 s:  x(t) = p + 1.5 t + (x0 - p) e^(-2t),  p = (1 - 1.5)/2
    t, p = 1.7, -0.25
    (x,) = drift(((-2.0,),), 2.0, [0.4], [1.0], t, [3.0])
    assert x == pytest.approx(p + 1.5 * t + (0.4 - p) * math.exp(-2 * t), rel=1e-14)


@settings(deadline=None)
@given(st.floats(-40, 40))
def test_phi_1_is_expm1_over_its_argument(x):
    p1, _ = phi(x)
    assert p1 == pytest.approx(math.expm1(x) / x if x else 1.0, rel=1e-13)


@settings(deadline=None)
@given(st.integers(-20 * 2**20, 20 * 2**20))
def test_phi_2_is_its_series(x):
    x /= 2**20
    exact = Fraction(0)
    term = Fraction(1, 2)
    for k in range(3, 120):
        exact += term
        term *= Fraction(x) / k
    assert phi(x)[1] == pytest.approx(float(exact), rel=1e-13)


def test_phi_refuses_an_argument_without_bound():
    with pytest.raises(PlantError, match="phi: argument"):
        phi(-math.inf)


@settings(deadline=None)
@given(st.floats(-1, 1e12, exclude_min=True))
def test_log1p_is_that_of_the_library(z):
    assert log1p(z) == pytest.approx(math.log1p(z), rel=2e-15, abs=5e-324)
