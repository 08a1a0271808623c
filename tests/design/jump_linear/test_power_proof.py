"""On which side of 1 the radius of many modes lies, by sums of powers, beside all eigenvalues of loops small enough for both."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.jump_linear import certificate, stability_proof
from design.jump_linear.certificate import certify_system
from design.jump_linear.mjls import MJLS
from design.jump_linear.second_moment import mean_square_radius
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
