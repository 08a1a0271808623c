"""Growth of fourth moments, against closed forms, all eigenvalues, and runs."""

from __future__ import annotations

import numpy as np
import pytest

from design.jump_linear import higher_moments
from design.jump_linear.higher_moments import fourth_moment_radius, fourth_moments
from design.jump_linear.second_moment import backward, congruence_matrices, mean_square_radius, operator_matrix


@pytest.mark.parametrize(("large", "state"), [(1.05, "bounded"), (1.3, "growing")])
def test_a_scalar_loop_grows_by_the_mean_of_fourth_powers(large: float, state: str) -> None:
    """x <- large x or 0.5 x, each with probability 1/2: E x^4 grows by (large^4 + 0.5^4) / 2, E x^2 stays below 1 in both."""
    A, P = np.array([[[large]], [[0.5]]]), np.full((2, 2), 0.5)
    found = fourth_moments(A, P)
    radius = (large**4 + 0.5**4) / 2
    assert found.state == state and found.radius == (pytest.approx(radius, rel=1e-6) if state == "growing" else None)
    assert fourth_moment_radius(A, P) == pytest.approx(radius, rel=1e-6)
    assert mean_square_radius(A, P) < 1.0


@pytest.mark.parametrize("seed", range(6))
def test_the_radius_is_the_largest_eigenvalue(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3, 3)) * rng.uniform(0.2, 0.7)
    P = rng.dirichlet(np.ones(3), size=3)
    W = congruence_matrices(A).transpose(0, 2, 1)
    exact = float(np.abs(np.linalg.eigvals(operator_matrix(W, P))).max())
    found = fourth_moments(A, P)
    assert fourth_moment_radius(A, P) == pytest.approx(exact, rel=1e-5)
    assert found.state == ("growing" if exact > 1 else "bounded")
    monkeypatch.setattr(higher_moments, "EXACT", 0)  # as of a large system
    grown = fourth_moments(A, P)
    radius = fourth_moment_radius(A, P)
    assert grown.state == found.state and (radius is None or radius == pytest.approx(exact, rel=1e-4))
    assert exact >= mean_square_radius(A, P) ** 2 * (1 - 1e-9)  # E x^4 >= (E x^2)^2


@pytest.mark.parametrize(("growth", "state"), [(0.9, "bounded"), (1.4, "growing")])
def test_the_units_of_the_states_decide_nothing(growth: float, state: str) -> None:
    """A controller's own states may have any."""
    rng = np.random.default_rng(0)
    A, P = rng.normal(size=(3, 5, 5)), rng.dirichlet(np.ones(3), size=3)
    radius = fourth_moment_radius(A, P)
    assert radius is not None
    A *= (growth / radius) ** 0.25
    for unit in ([1e6, 1e-6, 1.0, 1e5, 1e-4], [1e10, 1e-10, 1.0, 1.0, 1.0]):
        assert fourth_moments(A * unit / np.array(unit)[:, None], P).state == state


def test_where_the_equation_has_no_accurate_solution_products_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    A, P = np.array([[[1.05, 0.3], [0.0, 0.2]], [[0.5, 0.1], [0.1, 0.5]]]), np.full((2, 2), 0.5)
    monkeypatch.setattr(higher_moments, "ACCURATE", 0.0)
    assert fourth_moments(A, P).state == "bounded"
    monkeypatch.setattr(higher_moments, "MOST_PRODUCTS", 0)
    found = fourth_moments(A, P)
    assert (found.state, found.reason) == ("undecided", "rounding hides whether 12 moments grow")


def test_bounds_of_a_tail_and_too_many_moments_are_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    A, P = np.array([[[1.1]], [[0.5]]]), np.full((2, 2), 0.5)
    assert fourth_moments(A, P, upper=P * 1.05).state == "bounded"
    assert fourth_moments(A, P, upper=P * 2.0).state == "undecided"
    monkeypatch.setattr(higher_moments, "EXACT", 0)
    monkeypatch.setattr(higher_moments, "MOST_MOMENTS", 0)
    found = fourth_moments(A, P)
    assert found.state == "undecided" and found.radius is None and "2 moments" in found.reason


def test_one_moment_above_the_limit_is_one_too_many() -> None:
    found = fourth_moments(np.zeros((20_001, 1, 1)), np.empty((0, 0)))
    assert (found.state, found.reason) == ("undecided", "20001 moments are too many to tell")


def test_the_growth_is_sought_in_blocks_of_products_within_the_limit_of_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """A product of N modes of s coordinates takes 4 N s^3 + 2 N^2 s^2 operations."""
    rng = np.random.default_rng(4)
    A, P = rng.normal(size=(5, 2, 2)), rng.dirichlet(np.ones(5), size=5)
    W = congruence_matrices(A).transpose(0, 2, 1)
    growth, family = [0.0], np.array(np.broadcast_to(np.eye(3), W.shape))
    while len(growth) < 3 or abs(growth[-1] - growth[-2]) >= 1e-9 * 25:
        family = family / np.abs(family).max()
        for _ in range(25):
            family = backward(W, P, family)
        growth.append(float(np.log(np.abs(family).max())))
    work = 25 * (len(growth) - 1) * (4 * 5 * 3**3 + 2 * 5**2 * 3**2)
    monkeypatch.setattr(higher_moments, "EXACT", 0)
    monkeypatch.setattr(higher_moments, "MOST_FLOPS", float(work))
    assert fourth_moment_radius(A, P) == pytest.approx(np.exp(growth[-1] / 25), rel=1e-9)
    monkeypatch.setattr(higher_moments, "MOST_FLOPS", float(work - 1))
    assert fourth_moment_radius(A, P) is None
