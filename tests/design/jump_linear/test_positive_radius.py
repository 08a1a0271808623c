"""The radius of loops with many modes of few successors, found without an eigenvalue."""

from __future__ import annotations

import numpy as np
import pytest

import design.jump_linear.second_moment as second_moment
from design.jump_linear.certificate import certify_system
from design.jump_linear.mjls import MJLS
from design.jump_linear.second_moment import backward, cost_once, mean_square_radius, operator_matrix

Array = np.ndarray


def long_stay(modes: int, stay: float, n: int, seed: int, *, growth: float = 0.6) -> tuple[Array, Array]:
    """A mode that is left after one slot, and one that lasts: a mode of its own for every slot of its stay."""
    P = np.zeros((modes, modes))
    for i in range(modes - 1):
        P[i, i + 1], P[i, 0] = stay, 1.0 - stay
    P[-1, -1], P[-1, 0] = stay, 1.0 - stay
    first, rest = np.random.default_rng(seed).normal(size=(2, n, n)) * growth
    return np.stack([first, *[rest] * (modes - 1)]), P


@pytest.mark.parametrize(("modes", "stay", "n"), [(150, 0.8, 2), (90, 0.95, 3), (400, 0.5, 1)])
def test_it_is_the_largest_eigenvalue_of_the_whole_matrix(modes: int, stay: float, n: int) -> None:
    for seed in range(2):
        A, P = long_stay(modes, stay, n, seed)
        whole = float(np.abs(np.linalg.eigvals(operator_matrix(A, P))).max())
        assert mean_square_radius(A, P) == pytest.approx(whole, rel=1e-8)


def test_a_chain_of_a_thousand_modes_is_decided_by_one_factorisation() -> None:
    """A scalar plant over a heavy tail: ARPACK had no answer in 900 s."""
    A, P = long_stay(1001, 0.9, 1, 1)
    A = A * np.sqrt(0.98 / mean_square_radius(A, P))
    S = cost_once(A, P, np.ones_like(A))
    assert np.abs(S - backward(A, P, S) - 1.0).max() < 1e-9 * np.abs(S).max() and (S > 0.0).all()
    found = certify_system(MJLS(A=A, B=np.ones((1, 1)), C=np.ones((1, 1)), transition=P))
    assert found.state == "certified" and found.mean_square_radius == pytest.approx(0.98, rel=1e-8)
    assert certify_system(MJLS(A=1.02 * A, B=np.ones((1, 1)), C=np.ones((1, 1)), transition=P)).state == "refused"


def test_what_arpack_has_not_found_is_not_its_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a crowded spectrum the eigenvalues that converged first need not be the largest."""
    rng = np.random.default_rng(2)
    P = rng.dirichlet(np.ones(50), 50)
    A = rng.normal(size=(50, 3, 3)) * 0.4
    whole = float(np.abs(np.linalg.eigvals(operator_matrix(A, P))).max())

    def tired(*given: object, **named: object) -> None:
        from scipy.sparse.linalg import ArpackNoConvergence

        raise ArpackNoConvergence("tired", np.array([0.5 * whole]), np.zeros((1, 1)))

    monkeypatch.setattr("scipy.sparse.linalg.eigs", tired)
    assert mean_square_radius(A, P) == pytest.approx(whole, rel=1e-9)
    monkeypatch.setattr(second_moment, "EIG_DENSE_AFTER", 10)
    assert whole <= mean_square_radius(A, P) < 1.0 and np.isnan(mean_square_radius(A, P, bounded=False))
