"""Solvers of the second-moment equations: dense, one mode, GMRES, each beside the plain matrix."""

from __future__ import annotations

import numpy as np
import pytest

from design.jump_linear import MJLS, second_moment
from design.jump_linear.certificate import certify_system
from design.jump_linear.long_computations import PRODUCTS, gmres
from design.jump_linear.second_moment import Bordered, Resolvent, backward, forward, mean_square_radius, operator_matrix

Arrays = tuple[np.ndarray, np.ndarray]


def system(modes: int, n: int, radius: float, seed: int = 1) -> Arrays:
    rng = np.random.default_rng(seed)
    A, transition = rng.normal(size=(modes, n, n)), rng.dirichlet(np.ones(modes), modes)
    return A * np.sqrt(radius / mean_square_radius(A, transition)), transition


def symmetric(shape: tuple[int, ...], seed: int = 2) -> np.ndarray:
    family = np.random.default_rng(seed).normal(size=shape)
    return family + family.swapaxes(-1, -2)


@pytest.mark.parametrize(("modes", "n", "radius"), [(1, 6, 0.9), (1, 30, 0.99), (3, 5, 0.99), (12, 12, 0.9), (12, 12, 0.999)])
def test_both_equations_are_solved_to_rounding(modes: int, n: int, radius: float) -> None:
    A, transition = system(modes, n, radius)
    right = symmetric((2, modes, n, n))
    resolvent = Resolvent(A, transition)
    for solution, operator in ((resolvent.cost(right), backward), (resolvent.covariance(right), forward)):
        for S, Q in zip(solution, right):
            assert np.abs(S - operator(A, transition, S) - Q).max() < 1e-10 * np.abs(S).max()


def test_on_the_edge_of_stability_the_search_ends_and_says_so() -> None:
    """A radius of 1 to 13 digits: no solution exists to working accuracy, and the products are bounded."""
    A, transition = system(20, 10, 1.0)
    count = 0

    def counted(vector: np.ndarray) -> np.ndarray:
        nonlocal count
        count += 1
        return vector - matrix @ vector

    matrix = operator_matrix(A, transition)
    right = np.random.default_rng(3).normal(size=len(matrix))
    assert gmres(counted, right) is None
    assert count <= PRODUCTS + 2
    assert np.isnan(Resolvent(A, transition).cost(symmetric((20, 10, 10)))).all()


def test_the_radius_of_one_large_mode_is_that_of_the_whole_operator() -> None:
    A, transition = np.random.default_rng(6).normal(size=(1, 15, 15)), np.ones((1, 1))
    assert mean_square_radius(A, transition) == pytest.approx(np.abs(np.linalg.eigvals(operator_matrix(A, transition))).max())


def test_zero_is_the_solution_of_zero() -> None:
    assert not np.any(gmres(lambda v: v, np.zeros(4)))


@pytest.mark.parametrize("transposed", [False, True])
def test_the_bordered_matrix_is_solved_alike_dense_and_matrix_free(monkeypatch: pytest.MonkeyPatch, transposed: bool) -> None:
    A, transition = system(5, 6, 1.0)
    values, vectors = np.linalg.eig(operator_matrix(A, transition))
    right = np.real(vectors[:, np.argmax(values.real)])
    left = np.random.default_rng(4).normal(size=right.size)
    rhs = np.random.default_rng(5).normal(size=right.size + 1)
    dense = Bordered(A, transition, left, right).solve(rhs, transposed=transposed)
    monkeypatch.setattr(second_moment, "DENSE_LIMIT", 0)
    free = Bordered(A, transition, left, right).solve(rhs, transposed=transposed)
    assert np.abs(free - dense).max() < 1e-8 * np.abs(dense).max()


def test_a_large_loop_on_the_edge_of_stability_is_not_certified() -> None:
    """The matrix-free solver finds no Lyapunov matrix there, and the certificate says so instead of failing."""
    A, transition = system(20, 10, 1.0 - 1e-14)
    n = A.shape[-1]
    edge = MJLS(A=A, B=np.ones((20, n, 1)), C=np.ones((20, 1, n)), D=np.zeros((20, 1, 1)), transition=transition)
    found = certify_system(edge)
    assert not found.stable and found.state == "undecided"
