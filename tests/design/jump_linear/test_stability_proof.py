"""On which side of 1 the radius of many modes lies, by sums of powers, beside all eigenvalues of loops small enough for both."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import design.jump_linear.second_moment as second_moment
from design.jump_linear import MJLS, certificate, stability_proof
from design.jump_linear.certificate import certify_system
from design.jump_linear.second_moment import backward, cost_once, mean_square_radius, operator_matrix
from design.jump_linear.stability_proof import side_of_one
from hil.certify.send_all_loop import second_moment_verdict

Array = np.ndarray


def random_loop(seed: int, radius: float) -> tuple[Array, Array]:
    """A loop of a given radius: dense, sparse or cyclic chains; every other one has a state that is forgotten in every slot."""
    rng = np.random.default_rng(seed)
    N, n = int(rng.integers(2, 10)), int(rng.integers(2, 6))
    P = rng.dirichlet(np.full(N, rng.choice([0.1, 1.0])), N) if seed % 3 else np.roll(np.eye(N), 1, axis=1)
    A = rng.normal(size=(N, n, n))
    if seed % 2:
        A[:, :, -1] = 0.0
    return A * np.sqrt(radius / mean_square_radius(A, P)), P


@pytest.mark.parametrize("radius", [0.9, 0.97, 0.99, 1.01, 1.03, 1.2, 40.0])
def test_the_side_is_that_of_all_eigenvalues_and_the_bound_lies_between(radius: float) -> None:
    for seed in range(8):
        A, P = random_loop(seed, radius)
        found = side_of_one(A, P, 2_000_000)
        assert found.stable is (radius < 1.0), (seed, found)
        low, high = sorted((1.0, found.bound))
        assert low <= 1.0 <= high and (found.bound >= radius if radius < 1.0 else 1.0 < found.bound <= radius), (seed, found)
        assert found.falls > found.rounding and abs(found.least) > found.rounding and (found.least > 0.0) is (radius < 1.0)


def test_a_family_is_judged_by_its_own_product(monkeypatch: pytest.MonkeyPatch) -> None:
    """Powers that were computed wrongly, too small by far, prove nothing."""
    A, P = random_loop(3, 1.05)
    real = stability_proof.mean
    calls: list[int] = []

    def wrong(chains: Any, family: Array) -> Array:
        calls.append(0)
        return real(chains, family) * (0.0 if len(calls) == 1 else 1.0)

    monkeypatch.setattr(stability_proof, "mean", wrong)
    assert side_of_one(A, P, 2 * A.size).stable is None


def test_where_the_budget_ends_nothing_is_said() -> None:
    A, P = random_loop(1, 1.0 - 1e-9)
    assert side_of_one(A, P, 100_000).stable is None
    A, P = random_loop(1, 1.0 + 1e-9)
    assert side_of_one(A, P, 100_000).stable is None


def test_moments_that_outgrow_every_number_are_no_proof_of_the_wrong_side() -> None:
    for size in (1e30, 1e90, 1e160):
        A, P = random_loop(2, 1.0)
        with np.errstate(all="ignore"):  # as where a loop is composed
            assert side_of_one(A * size, P, 10_000).stable is not True
    assert side_of_one(np.zeros((3, 2, 2)), np.full((3, 3), 1 / 3)).stable is True


@pytest.fixture
def crowded(monkeypatch: pytest.MonkeyPatch) -> None:
    """No eigenvalue is found, as of a crowded spectrum over many modes."""
    monkeypatch.setattr(MJLS, "radius", lambda self, bounded=True: float("nan"))


@pytest.mark.parametrize(("radius", "state", "is_"), [(0.97, "certified", "at most"), (1.03, "refused", "at least")])
def test_a_loop_without_eigenvalues_is_certified_or_refused_with_its_bound(
    radius: float, state: str, is_: str, crowded: None
) -> None:
    A, P = random_loop(5, radius)
    n = A.shape[-1]
    found = certify_system(MJLS(A=A, B=np.eye(n), C=np.eye(n), transition=P), hinf=True)
    assert (found.state, found.radius_is, found.stable) == (state, is_, state == "certified")
    assert found.h2_norm is None and found.hinf_norm is None
    assert sorted((radius, found.mean_square_radius, 1.0))[1] == found.mean_square_radius
    assert is_ in found.reason and found.to_json()["radius_is"] == is_
    assert f"second-moment radius {is_} " in second_moment_verdict(found, "0" * 64).reason


def test_what_the_budget_does_not_decide_is_undecided_by_its_number(monkeypatch: pytest.MonkeyPatch, crowded: None) -> None:
    monkeypatch.setattr(certificate, "side_of_one", lambda A, transition: side_of_one(A, transition, 1000))
    A, P = random_loop(5, 0.999)
    n = A.shape[-1]
    found = certify_system(MJLS(A=A, B=np.eye(n), C=np.eye(n), transition=P))
    assert found.state == "undecided" and "no eigenvalue was found" in found.reason and np.isnan(found.mean_square_radius)


def test_bounds_of_a_chain_are_decided_from_above_and_refused_from_below(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a mode that stands for many, the upper bounds certify and the lower ones refuse."""
    real = mean_square_radius
    monkeypatch.setattr(MJLS, "radius", lambda self, bounded=True: float("nan"))
    monkeypatch.setattr(
        certificate, "mean_square_radius", lambda A, P, bounded=True: side_of_one(A, P).bound if bounded else float("nan")
    )
    for radius, state in ((0.9, "certified"), (1.2, "refused"), (1.0, "undecided")):
        A, P = random_loop(4, radius)
        n, between = A.shape[-1], (0.95 * P, np.minimum(1.05 * P, 1.0))
        found = certify_system(MJLS(A=A, B=np.eye(n), C=np.eye(n), transition=P), between=between)
        assert found.state == state, (radius, found)
        if state == "certified":
            assert found.tail_radius is not None and real(A, between[1]) <= found.tail_radius < 1.0


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


def test_a_secant_finds_it_where_halving_would_need_thirty_solutions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stability_proof, "MOST_SOLUTIONS", 15)
    A, P = long_stay(150, 0.8, 2, 0)
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
