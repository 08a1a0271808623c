"""Solvers for many modes, beside the dense ones on loops small enough for both."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.jump_linear import MJLS, H2Nearby, bounded_real, certificate, coupled_lyapunov, h2_derivative, second_moment
from design.jump_linear.bounded_real import bounded_real_margin, hinf_norm
from design.jump_linear.coupled_lyapunov import ShiftStates, factors_of, mean
from design.jump_linear.second_moment import Bordered, Resolvent, mean_square_radius, operator_matrix
from design.jump_linear.stability_proof import StabilityProof
from design.networked_loop.affine_loop import LoopStructure
from design.networked_loop.closed_loop import loop_structure

PLANT = ([[0.9, 0.3], [-0.1, 0.8]], [[0.2], [1.0]], [[1.0, 0.4]])
SC = [[0.6, 0.4, 0.0], [0.5, 0.2, 0.3], [0.4, 0.3, 0.3]]
CA = [[0.7, 0.3, 0.0], [0.5, 0.3, 0.2], [0.6, 0.2, 0.2]]
SHAPES: tuple[dict[str, Any], ...] = (
    {"selection": "applied"},
    {"selection": "previous", "samples": 2},
    {"selection": "generated", "integral": 0.1},
)


def loop(options: dict[str, Any]) -> LoopStructure:
    return loop_structure(*PLANT, SC, CA, **options)


def gains_of(structure: LoopStructure, size: float = 0.08, seed: int = 0) -> np.ndarray:
    return -size * (1.0 + 0.3 * np.random.default_rng(seed).normal(size=structure.gain_shape))


def matrices(options: dict[str, Any], **chosen: Any) -> tuple[np.ndarray, np.ndarray]:
    structure = loop(options)
    return structure.matrices(gains_of(structure, **chosen)), structure.transition


def symmetric(shape: tuple[int, ...], seed: int = 2) -> np.ndarray:
    family = np.random.default_rng(seed).normal(size=shape)
    return family + family.swapaxes(-1, -2)


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> None:
    """No dense factorisation, and shift states eliminated wherever there are enough of them."""
    monkeypatch.setattr(second_moment, "DENSE_LIMIT", 0)
    monkeypatch.setattr(bounded_real, "DENSE_LIMIT", 0)
    monkeypatch.setattr(coupled_lyapunov, "LIMIT", 0)


@pytest.mark.parametrize("options", SHAPES)
def test_both_equations_without_shift_states_have_the_solutions_of_the_whole(options: dict[str, Any], free: None) -> None:
    A, transition = matrices(options)
    families = symmetric((2, *A.shape))
    found = Resolvent(A, transition)
    assert ShiftStates(A, factors_of(transition)).free < A.shape[-1] / 2  # eliminated, not solved as a whole
    whole = np.eye(operator_matrix(A, transition).shape[0]) - operator_matrix(A, transition)
    right = second_moment.to_vector(families).reshape(2, -1)
    for solution, matrix in ((found.cost(families), whole), (found.covariance(families), whole.T)):
        expected = np.linalg.solve(matrix, right.T).T.reshape(*right.shape)
        assert np.abs(second_moment.to_vector(solution).reshape(2, -1) - expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("transposed", [False, True])
def test_the_bordered_matrix_is_solved_without_shift_states_too(transposed: bool, free: None) -> None:
    A, transition = matrices(SHAPES[0])
    size = operator_matrix(A, transition).shape[0]
    rng = np.random.default_rng(3)
    left, right, rhs = rng.normal(size=size), rng.normal(size=size), rng.normal(size=size + 1)
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size] = operator_matrix(A, transition) - np.eye(size)
    whole[:size, size], whole[size, :size] = left, right
    expected = np.linalg.solve(whole.T if transposed else whole, rhs)
    found = Bordered(A, transition, left, right).solve(rhs, transposed=transposed, near=rng.normal(size=size))
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


def test_where_both_delays_reach_eight_ninety_three_numbers_a_mode_are_unknown() -> None:
    chain = np.full((9, 9), 1.0 / 9.0)
    structure = loop_structure(*PLANT, chain, chain, "applied")
    A = structure.matrices(gains_of(structure))
    states = ShiftStates(A, factors_of(structure.transition))
    assert A.shape == (81, 47, 47)
    assert (states.free, states.places.size, [len(w) for w in states.factors]) == (2, 93, [9, 9])


def test_two_independent_chains_are_distinguished_from_one_that_is_not() -> None:
    joint = np.kron(SC, CA)
    first, second = factors_of(joint)
    assert np.abs(first - SC).max() < 1e-15 and np.abs(second - CA).max() < 1e-15
    family = np.random.default_rng(1).normal(size=(9, 2, 2))
    assert np.abs(mean((first, second), family) - np.tensordot(joint, family, axes=1)).max() < 1e-14
    joint[0, 0], joint[0, 1] = joint[0, 0] - 1e-9, joint[0, 1] + 1e-9
    one, whole = factors_of(joint)
    assert one.shape == (1, 1) and whole is joint


@pytest.mark.parametrize("options", SHAPES)
def test_along_a_descent_value_and_derivative_are_those_of_each_loop_alone(options: dict[str, Any], free: None) -> None:
    structure = loop(options)
    alpha = structure.default_initial
    nearby = H2Nearby(structure.B, structure.C, structure.transition, alpha)
    for seed, size in enumerate((0.02, 0.0201, 0.018, 0.03)):
        A = structure.matrices(gains_of(structure, size, seed))
        found, alone = nearby.derivative(A), h2_derivative(A, structure.B, structure.C, structure.transition, alpha)
        assert found is not None and alone is not None
        assert abs(found.square / alone.square - 1.0) < 1e-12
        for mine, theirs in ((found.gradient_A, alone.gradient_A), (found.S, alone.S)):
            assert np.abs(mine - theirs).max() < 1e-7 * np.abs(theirs).max()
    unstable = structure.matrices(gains_of(structure, 40.0))
    assert nearby.derivative(unstable) is None


def test_a_proof_of_one_loop_is_not_taken_for_another_that_is_unstable() -> None:
    A, transition = matrices(SHAPES[0])
    proof = StabilityProof(transition)
    assert proof.holds(A)
    for radius in (0.999, 1.001, 1.5):
        scaled = A * np.sqrt(radius / mean_square_radius(A, transition))
        assert proof.holds(scaled) is (radius < 1.0)


def test_the_worst_case_norm_and_its_margin_are_those_of_the_dense_way(request: pytest.FixtureRequest) -> None:
    structure = loop(SHAPES[0])
    system = structure.system(gains_of(structure))
    dense = hinf_norm(system)
    request.getfixturevalue("free")
    norm = hinf_norm(system)
    assert norm == pytest.approx(dense, rel=1e-9)
    margin = bounded_real_margin(system, norm * (1.0 + 1e-6))
    assert margin is not None and margin > 0.0
    assert bounded_real_margin(system, norm * (1.0 - 1e-3)) is None


def test_a_loop_without_shift_states_is_solved_as_a_whole(free: None) -> None:
    rng = np.random.default_rng(5)
    A, transition = rng.normal(size=(6, 5, 5)), rng.dirichlet(np.ones(6), 6)
    A *= np.sqrt(0.95 / mean_square_radius(A, transition))
    system = MJLS(A=A, B=np.eye(5), C=np.eye(5), transition=transition)
    weight = symmetric(A.shape)
    assert ShiftStates(A, factors_of(transition)).free == 5
    S = Resolvent(A, transition).cost(weight)
    assert np.abs(S - second_moment.backward(A, transition, S) - weight).max() < 1e-10 * np.abs(S).max()
    assert system.modes == 6


def test_a_system_of_too_many_second_moments_is_undecided_by_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit of a product that ends within a second is some 390 modes of 100 states, not 1600; here it is made small."""
    structure = loop(SHAPES[0])
    gains = np.zeros(structure.gain_shape)
    system = structure.system(gains)
    numbers = system.modes * system.order * (system.order + 1) // 2
    monkeypatch.setattr(certificate, "MOST_UNKNOWNS", numbers)
    assert certificate.certify_system(system).state == "certified"
    monkeypatch.setattr(certificate, "MOST_UNKNOWNS", numbers - 1)
    found = certificate.certify_system(system)
    assert found.state == "undecided" and not found.stable and np.isnan(found.mean_square_radius)
    assert f"{system.modes} modes over {system.order} states" in found.reason
    monkeypatch.undo()
    assert not certificate.too_large(390, 100) and "1600 modes over 100 states" in certificate.too_large(1600, 100)
    assert not certificate.too_large(1, 5000)  # one mode takes the eigenvalues of its matrix
