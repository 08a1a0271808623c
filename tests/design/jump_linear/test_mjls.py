"""Radius and H2 norm of jump-linear systems, against closed forms, brute force and the published numbers."""

import numpy as np
import pytest
import scipy.linalg

from design.errors import NotStable
from design.jump_linear import MJLS, h2_derivative, h2_norm
from design.jump_linear.second_moment import (
    Resolvent,
    backward,
    forward,
    mean_square_radius,
    operator_matrix,
    to_matrix,
    to_vector,
)
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import loop_structure
from tests.design.chapter7 import LAMBDA, MOTOR, PI, PRINTED_H2, PRINTED_HINF, PRINTED_VTOL_H2, VTOL, VTOL_R


def random_family(rng, N, n):
    S = rng.standard_normal((N, n, n))
    return S + S.transpose(0, 2, 1)


def random_system(seed, N=4, n=3, size=0.7):
    rng = np.random.default_rng(seed)
    P = rng.random((N, N)) + 0.05
    return size * rng.standard_normal((N, n, n)) / np.sqrt(n), P / P.sum(axis=1, keepdims=True), rng


def test_coordinates_are_an_isometry():
    rng = np.random.default_rng(0)
    S = random_family(rng, 5, 4)
    assert np.allclose(to_matrix(to_vector(S), 4), S, atol=1e-15)
    assert np.isclose(np.sum(to_vector(S) ** 2), np.sum(S**2))


def test_operator_matrix_is_the_operator_and_its_transpose_the_adjoint():
    A, P, rng = random_system(1)
    S = random_family(rng, 4, 3)
    M = operator_matrix(A, P)
    assert np.allclose((M @ to_vector(S).ravel()).reshape(4, -1), to_vector(backward(A, P, S)))
    assert np.allclose((M.T @ to_vector(S).ravel()).reshape(4, -1), to_vector(forward(A, P, S)))


def test_resolvent_solves_both_equations_dense_and_matrix_free(monkeypatch):
    A, P, rng = random_system(2, size=0.5)
    Q = random_family(rng, 4, 3)
    solutions = []
    for limit in (10**6, 0):
        monkeypatch.setattr("design.jump_linear.second_moment.DENSE_LIMIT", limit)
        resolvent = Resolvent(A, P)
        S, X = resolvent.cost(Q), resolvent.covariance(Q)
        assert np.allclose(S - backward(A, P, S), Q, atol=1e-10)
        assert np.allclose(X - forward(A, P, X), Q, atol=1e-10)
        solutions.append((S, X))
    assert np.allclose(solutions[0], solutions[1], atol=1e-9)


def test_matrix_free_radius_equals_the_dense_one(monkeypatch):
    for seed in range(5):
        A, P, _ = random_system(seed, N=5, n=4)
        dense = mean_square_radius(A, P)
        with monkeypatch.context() as patch:
            patch.setattr("design.jump_linear.second_moment.EIG_DENSE_LIMIT", 0)
            assert np.isclose(mean_square_radius(A, P), dense, rtol=1e-9)


def test_one_mode_is_the_ordinary_lyapunov_theory():
    rng = np.random.default_rng(3)
    A, B, C = 0.4 * rng.standard_normal((3, 3)), rng.standard_normal((3, 2)), rng.standard_normal((2, 3))
    system = MJLS(A=A[None], B=B, C=C, transition=[[1.0]])
    gram = scipy.linalg.solve_discrete_lyapunov(A.T, C.T @ C)
    assert np.isclose(h2_norm(system), np.sqrt(np.trace(B.T @ gram @ B)))
    assert np.isclose(h2_norm(system, definition="mean"), h2_norm(system))
    assert np.isclose(system.radius(), np.abs(np.linalg.eigvals(A)).max() ** 2)


def test_radius_separates_stability_of_the_mean_from_stability_of_the_second_moment():
    # scalar, independent modes 0 and 1.9: E a = 0.95 contracts, E a^2 = 1.805 does not
    system = MJLS(A=[[[0.0]], [[1.9]]], B=[[1.0]], C=[[1.0]], transition=np.full((2, 2), 0.5))
    assert np.isclose(system.radius(), 0.5 * 1.9**2)
    with pytest.raises(NotStable, match=r"radius 1\.805") as caught:
        h2_norm(system)
    assert np.isclose(caught.value.value, 1.805)


def test_h2_norm_is_the_sum_over_all_paths():
    A, P, rng = random_system(5, N=2, n=2, size=0.4)
    B, C = rng.standard_normal((2, 1)), rng.standard_normal((1, 2))
    alpha = np.array([0.3, 0.7])

    def energy(i, x, depth):  # E of the remaining |z|^2, over every path of `depth` steps
        if depth == 0:
            return 0.0
        return sum(P[i, j] * ((C @ x).item() ** 2 + energy(j, A[j] @ x, depth - 1)) for j in range(2))

    def both(i, depth):
        return energy(i, B[:, 0], depth)

    def mean(i, depth):  # |E z|^2 as printed
        first = {j: P[i, j] * B[:, 0] for j in range(2)}
        total = 0.0
        for _ in range(depth):
            total += (C @ (first[0] + first[1])).item() ** 2
            first = {j: sum(P[k, j] * A[k] @ first[k] for k in range(2)) for j in range(2)}
        return total

    system = MJLS(A=A, B=B, C=C, transition=P)
    assert np.isclose(h2_norm(system, alpha) ** 2, sum(alpha[i] * both(i, 14) for i in range(2)), rtol=1e-4)
    printed = h2_norm(system, alpha, definition="mean") ** 2
    assert np.isclose(printed, sum(alpha[i] * mean(i, 60) for i in range(2)), rtol=1e-9)
    assert printed < h2_norm(system, alpha) ** 2


def test_h2_derivative_is_the_difference_quotient():
    for plant, R, gains in ((MOTOR, 0.01, PRINTED_H2), (VTOL, VTOL_R, PRINTED_VTOL_H2)):
        loop = loop_structure(*plant, LAMBDA, PI, "generated", R=R)
        alpha = np.full(6, 1 / 6)

        def value(K, loop=loop, alpha=alpha):
            return h2_derivative(loop.matrices(K), loop.B, loop.C, loop.transition, alpha)

        exact = loop.gain_gradient(value(gains).gradient_A)
        rng = np.random.default_rng(0)
        for _ in range(4):
            step = 1e-5 * np.abs(gains).max() * rng.standard_normal(gains.shape)
            quotient = (value(gains + step).square - value(gains - step).square) / 2
            assert np.isclose(quotient, np.sum(exact * step), rtol=1e-5)


def test_unstable_loops_have_no_derivative():
    loop = loop_structure(*MOTOR, LAMBDA, PI, "constant")
    matrices = loop.matrices(np.full(loop.gain_shape, -0.4515))
    assert h2_derivative(matrices, loop.B, loop.C, loop.transition, np.full(6, 1 / 6)) is None


def test_published_gains_have_the_recomputed_radii_and_norms():
    hinf = certify_loop(*MOTOR, LAMBDA, PI, PRINTED_HINF, "generated", output="sum")
    h2 = certify_loop(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", output="sum")
    vtol = certify_loop(*VTOL, LAMBDA, PI, PRINTED_VTOL_H2, "generated", R=VTOL_R, output="sum")
    assert round(hinf.mean_square_radius, 4) == 0.8977
    assert round(h2.mean_square_radius, 4) == 0.9165
    assert round(h2.h2_norm, 4) == 3.7368  # printed 5.0147
    assert round(vtol.h2_norm, 4) == 0.1220  # printed 0.1225
    for certificate in (hinf, h2, vtol):
        assert certificate.stable and certificate.lyapunov_margin > 1e6 * certificate.rounding
        assert certificate.h2_residual < 1e-12


def test_published_local_gains_are_not_mean_square_stable_over_the_network():
    motor = certify_loop(*MOTOR, LAMBDA, PI, np.full((3, 1, 1, 1), -0.4515), "constant")
    gain = np.broadcast_to(np.array([[-56.0196], [-10.5998]]), (3, 1, 2, 1))
    vtol = certify_loop(*VTOL, LAMBDA, PI, gain, "constant", R=VTOL_R)
    assert (round(motor.mean_square_radius, 3), motor.stable, motor.h2_norm) == (1.054, False, None)
    assert (round(vtol.mean_square_radius, 2), vtol.stable) == (1.22, False)


def test_state_store_changes_nothing():
    values = [
        h2_norm(loop_structure(*VTOL, LAMBDA, PI, "generated", R=VTOL_R, store=store).system(PRINTED_VTOL_H2))
        for store in ("output", "state")
    ]
    assert np.isclose(*values, rtol=1e-9)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"A": np.eye(2)[None]}, r"A: shape \(1, 2, 2\), expected 2 matrices"),
        ({"A": np.ones((2, 2, 3))}, "A: shape"),
        ({"B": np.ones((3, 1))}, "B: 3 rows, expected 2"),
        ({"C": np.ones((1, 3))}, "C: 3 columns, expected 2"),
        ({"D": np.ones((2, 1))}, "D: 2 rows, expected 1"),
        ({"A": np.full((2, 2, 2), np.inf)}, r"A\[0\]: not finite"),
        ({"transition": [[1.0, 0.1], [0, 1]]}, r"transition\[0\]: row sums to 1.1"),
        ({"transition": [[1.5, -0.5], [0, 1]]}, r"transition\[0\]\[1\]: -0.5 is negative"),
    ],
)
def test_wrong_matrices_are_refused_by_name(change, message):
    good = {"A": np.zeros((2, 2, 2)), "B": np.ones((2, 1)), "C": np.ones((1, 2)), "transition": np.eye(2)}
    with pytest.raises(ValueError, match="^" + message):
        MJLS(**(good | change))


def test_initial_distribution_is_checked():
    system = MJLS(A=np.zeros((2, 1, 1)), B=[[1.0]], C=[[1.0]], transition=np.eye(2))
    with pytest.raises(ValueError, match=r"^initial: entries must be >= 0 and sum to 1, sum is 1\.5"):
        h2_norm(system, [1.0, 0.5])
