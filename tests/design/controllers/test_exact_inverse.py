"""Inverses and products that are the same on every machine."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from design.controllers import LoopModel, feedforward
from design.controllers.exact_products import dot, product, product_of_batch, pseudo_inverse


@pytest.mark.parametrize("shape", [(1, 1), (4, 4), (3, 5), (5, 3), (9, 9)])
def test_an_inverse_is_the_inverse_rounded_once(shape: tuple[int, int]) -> None:
    N = np.random.default_rng(0).standard_normal(shape)
    N[0, 0] = 0.0  # a first pivot that is none
    if N.size == 1:
        N[0, 0] = 3.0
    found = pseudo_inverse(N)
    assert found == pytest.approx(np.linalg.pinv(N), rel=1e-9, abs=1e-12)
    if shape[0] == shape[1]:
        exact = [[Fraction(x) for x in row] for row in N.tolist()]
        for i, row in enumerate(exact):
            for j in range(shape[1]):
                residual = sum(a * Fraction(b) for a, b in zip(row, found[:, j].tolist())) - (i == j)
                bound = sum(abs(a) * abs(Fraction(b)) for a, b in zip(row, found[:, j].tolist()))
                assert abs(residual) <= bound * Fraction(1, 2**53), "half a unit in the last place of every entry"


def test_of_a_matrix_without_full_rank_it_is_the_pseudo_inverse() -> None:
    N = np.outer([1.0, 2.0, 3.0], [4.0, 5.0])
    assert pseudo_inverse(N) == pytest.approx(np.linalg.pinv(N), rel=1e-8)


def test_products_are_summed_in_their_order() -> None:
    rng = np.random.default_rng(1)
    assert product_of_batch([[2.0], [3.0]], np.array([[0.5, 7.0]])).tolist() == [[1.0, 14.0], [1.5, 21.0]]
    rows, x = rng.standard_normal((3, 5)).tolist(), rng.standard_normal((5, 7))
    many = product_of_batch(rows, x)
    for run in range(7):
        one = product(rows, x[:, run].tolist())
        assert many[:, run].tolist() == one
        assert one == [(((0.0 + r[0] * c[0]) + r[1] * c[1]) + r[2] * c[2]) + r[3] * c[3] + r[4] * c[4]
                       for r, c in ((row, x[:, run].tolist()) for row in rows)]  # fmt: skip
    assert dot([], []) == 0.0


@pytest.mark.parametrize("unit", [1.0, 1e-10, 1e10])
def test_the_input_that_holds_a_reference_does_not_depend_on_the_units_of_the_states(unit: float) -> None:
    A, B, C = np.array([[0.5, unit], [0.0, 0.5]]), np.array([[0.0], [1.0]]), np.array([[1.0 / unit, 0.0]])
    assert feedforward(LoopModel(A=A, B=B, C=C, period_s=0.1, tau_max=0, d_max=0)) == pytest.approx(np.array([[0.25]]))
