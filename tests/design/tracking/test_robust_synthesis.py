"""Gains of least guaranteed cost for norm-bounded plants (7.41)."""

from __future__ import annotations

import numpy as np
import pytest

from design.networked_loop.uncertainty import guaranteed_h2, robust_h2, robust_norms, uncertainty_margin
from design.tracking.robust_synthesis import _with_slope, robust
from design.tracking.synthesis import Design, TrackingProblem, solve

M, N1, N2 = np.array([[1.0]]), np.array([[0.0]]), np.array([[0.6]])
"""The input acts with 0.4 to 1.6 of its effect."""


@pytest.fixture(scope="module")
def nominal() -> Design:
    return solve(TrackingProblem(A=[[1.2]], B=[[1.0]], C=[[1.0]], sc=[[0.7, 0.3], [0.7, 0.3]], ca=[[1.0]], R=0.1))


def bears(design: Design, size: float = 1.0) -> float:
    return uncertainty_margin(design.problem.structure(), design.gains, M, N1, size * N2)


def test_gains_that_bear_the_uncertainty_are_found_where_the_nominal_ones_do_not(nominal: Design) -> None:
    assert bears(nominal, 0.9) < 1.0
    seen: list[tuple[str, int, int, float]] = []
    found = robust(nominal, M, N1, 0.9 * N2, progress=lambda *said: seen.append(said))
    assert bears(found, 0.9) > 1.0 and found.certificate.stable
    structure = found.problem.structure()
    least = min(value for stage, _, _, value in seen if stage == "guaranteed h2")
    assert seen[0] == ("margin", 1, 1, pytest.approx(bears(nominal, 0.9)))
    assert 1.0 <= robust_norms(structure, found.gains, M, N1, 0.9 * N2).h2 / least < 1.0001
    assert (found.certificate.h2_norm or 0.0) > (nominal.certificate.h2_norm or 0.0)


def test_no_gains_nearby_have_a_smaller_guaranteed_cost(nominal: Design) -> None:
    found = robust(nominal, M, N1, 0.2 * N2)
    structure = found.problem.structure()
    alpha = found.problem.alpha(structure)
    norms = robust_norms(structure, found.gains, M, N1, 0.2 * N2)
    assert norms.h2 < robust_norms(structure, nominal.gains, M, N1, 0.2 * N2).h2
    around = robust_h2(structure, found.gains, M, N1, 0.2 * N2)[1] * np.geomspace(0.5, 2.0, 81)

    def least(gains: np.ndarray) -> float:
        return min(guaranteed_h2(structure, gains, M, N1, 0.2 * N2, alpha, float(multiplier)) for multiplier in around)

    for step in np.vstack([1e-2 * np.eye(found.gains.size), -1e-2 * np.eye(found.gains.size)]):
        assert least(found.gains + step.reshape(found.gains.shape)) > least(found.gains)


def test_what_no_gains_bear_ends_with_the_largest_margin_that_was_found(nominal: Design) -> None:
    found = robust(nominal, M, N1, 5.0 * N2)
    assert bears(nominal, 5.0) < bears(found, 5.0) < 1.0


def test_a_difference_below_what_a_cost_is_known_to_says_no_slope() -> None:
    noisy = _with_slope(lambda v: 5.0 + 1e-9 * float(v[0] > 0.0) + 0.5 * float(v[1]), lambda _: None)
    value, slope = noisy(np.zeros(2))
    assert value == 5.0 and slope[0] == 0.0, "a search that follows rounding does not end"
    assert slope[1] == pytest.approx(0.5, rel=1e-4)
