"""Sojourn laws whose powers and logarithms decide nothing by a last bit."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest

from transport.laws.sojourn import TAIL, DiscreteWeibull, Geometric, powers, whole_powers
from transport.laws.stochastic_matrix import stationary_row


def rounded(value: Decimal, bits: int) -> float:
    """Return a number of 60 digits at so many bits."""
    _, exponent = math.frexp(float(value))
    return math.ldexp(int((value * Decimal(2) ** (bits - exponent)).to_integral_value()), exponent - bits)


@pytest.mark.parametrize(("q", "beta"), [(0.6, 2.0), (0.93, 0.7), (0.5, 1.3)])
def test_every_power_is_rounded_from_higher_precision(q: float, beta: float) -> None:
    slots = np.arange(200)
    with localcontext(prec=60, Emin=-(10**6)):
        exact = [rounded(Decimal(q) ** (Decimal(int(n)) ** Decimal(beta)), 43) if n else 1.0 for n in slots]
    assert powers(q, beta, slots).tolist() == exact


def test_whole_powers_are_products() -> None:
    assert whole_powers(0.5, np.arange(60)).tolist() == [2.0**-n for n in range(60)]
    assert whole_powers(0.9, np.arange(100)) == pytest.approx(0.9 ** np.arange(100), rel=1e-14)


@pytest.mark.parametrize("law", [Geometric(p=0.25), DiscreteWeibull(q=0.6, beta=2.0), DiscreteWeibull(q=0.75, beta=0.5)])
def test_a_level_on_an_edge_of_the_law_draws_what_the_exact_law_says(law: Geometric | DiscreteWeibull) -> None:
    """Levels beside 1 - S(n), nearer than a logarithm in doubles can tell: h is the smallest n with S(n) <= 1 - u."""
    draw = law.sampler()
    for n in range(1, 12):
        with localcontext(prec=80):
            geometric = isinstance(law, Geometric)
            tail = (1 - Decimal(law.p)) ** n if geometric else Decimal(law.q) ** (Decimal(n) ** Decimal(law.beta))
            if tail < Decimal("1e-9"):  # levels of doubles are too coarse for longer ones
                break
            edge = float(1 - tail)
            for u in (math.nextafter(edge, 0.0), edge, math.nextafter(edge, 1.0)):
                rest = 1 - Decimal(u)
                # the limit itself belongs to n, and to n + 1 in the geometric law, whose levels begin there
                above = rest < tail or (geometric and rest == tail)
                assert draw(u) == (n + 1 if above else n), (n, u)


@pytest.mark.parametrize("beta", [0.5, 1.0, 1.3, 2.0])
@pytest.mark.parametrize("q", [0.1, 0.01, 0.001, 0.3, 0.9])
def test_a_support_ends_where_the_exact_law_falls_to_its_tail(q: float, beta: float) -> None:
    """Also where logarithms in doubles divide to a whole number: 0.1 is more than a tenth, so 0.1^12 is above 1e-12."""
    n = DiscreteWeibull(q=q, beta=beta).support
    with localcontext(prec=60, Emin=-(10**6)):
        before, at = (Decimal(q) ** (Decimal(k) ** Decimal(beta)) for k in (n - 1, n))
    assert at <= Decimal(TAIL) < before


def test_a_stationary_law_is_one_and_comes_of_plain_operations() -> None:
    rng = np.random.default_rng(1)
    P = rng.random((7, 7)) + 0.01
    P /= P.sum(axis=1, keepdims=True)
    law = stationary_row(P)
    assert law @ P == pytest.approx(law, abs=1e-15) and law.sum() == pytest.approx(1.0, abs=1e-15)
    # a chain that hardly ever changes: no difference of near numbers, so every digit counts
    slow = np.array([[1.0 - 1e-13, 1e-13], [3e-13, 1.0 - 3e-13]])
    assert stationary_row(slow) == pytest.approx([0.75, 0.25], rel=1e-14)
