"""H-infinity norms: against frequency sweeps, linear matrix inequalities, worst disturbances and published gains."""

import numpy as np
import pytest

from design.errors import NotStable
from design.jump_linear import MJLS, h2_norm
from design.jump_linear.bounded_real import (
    Fold,
    bounded_real_margin,
    hinf_norm,
    locate_norm,
    predict_fold,
    refine_fold,
    solve_bounded_real,
)
from design.jump_linear.second_moment import Resolvent, expect
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import loop_structure
from tests.design.chapter7 import LAMBDA, MOTOR, PI, PRINTED_H2, PRINTED_HINF, PRINTED_VTOL_HINF, VTOL, VTOL_R

# The discretisation printed for the motor, which is none of the plant at any sample period.
PRINTED_MOTOR = (np.array([[1.00021, 0.00460], [0.00460, 0.00004]]), np.array([[0.34868], [7.68069]]), MOTOR[2])


def loop(plant, gains, output="stacked", R=0.01):
    return loop_structure(*plant, LAMBDA, PI, "generated", R=R, output=output).system(gains)


def random_mjls(seed, N=3, n=3):
    rng = np.random.default_rng(seed)
    P = rng.random((N, N)) + 0.05
    return MJLS(
        A=0.55 * rng.standard_normal((N, n, n)) / np.sqrt(n), B=rng.standard_normal((N, n, 2)),
        C=rng.standard_normal((N, 2, n)), D=0.3 * rng.standard_normal((N, 2, 2)),
        transition=P / P.sum(axis=1, keepdims=True),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_one_mode_is_the_peak_of_the_frequency_response(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((4, 4))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = rng.standard_normal((4, 2)), rng.standard_normal((2, 4)), rng.standard_normal((2, 2))
    norm = hinf_norm(MJLS(A=A[None], B=B, C=C, D=D, transition=[[1.0]]))

    def gain(w):
        return np.linalg.norm(C @ np.linalg.solve(np.exp(1j * w) * np.eye(4) - A, B) + D, 2)

    grid = np.linspace(0, np.pi, 4001)
    peak = grid[int(np.argmax([gain(w) for w in grid]))]
    fine = max(gain(w) for w in np.linspace(peak - 1e-3, peak + 1e-3, 2001))
    assert np.isclose(norm, fine, rtol=1e-6)


def test_finite_memory_has_a_norm_without_a_fold():
    # z(k) = x(k), x(k+1) = w(k): the norm is 1 and no disturbance closes a loop
    system = MJLS(A=np.zeros((2, 1, 1)), B=[[1.0]], C=[[1.0]], transition=np.full((2, 2), 0.5))
    assert np.isclose(hinf_norm(system), 1.0, rtol=1e-6)
    assert hinf_norm(MJLS(A=np.zeros((1, 1, 1)), B=[[1.0]], C=[[0.0]], transition=[[1.0]])) == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_fold_agrees_with_the_linear_matrix_inequality(seed):
    import cvxpy as cp

    system = random_mjls(seed)
    A, B, C, D, transition = system.matrices
    square = cp.Variable()
    P = [cp.Variable((3, 3), symmetric=True) for _ in range(3)]
    constraints = []
    for i in range(3):
        E = sum(transition[i, j] * P[j] for j in range(3))
        AB, CD = np.hstack([A[i], B[i]]), np.hstack([C[i], D[i]])
        block = cp.bmat([[P[i], np.zeros((3, 2))], [np.zeros((2, 3)), square * np.eye(2)]])
        constraints.append(block - AB.T @ E @ AB - CD.T @ CD >> 0)
    cp.Problem(cp.Minimize(square), constraints).solve(solver=cp.CLARABEL)
    assert np.isclose(hinf_norm(system), np.sqrt(square.value), rtol=2e-6)


def test_norm_bounds_every_solution_and_none_exists_below_it():
    for seed in range(5):
        system = random_mjls(seed)
        norm = hinf_norm(system)
        assert solve_bounded_real(system.matrices, (norm * 1.001) ** 2) is not None
        assert solve_bounded_real(system.matrices, (norm * 0.999) ** 2) is None
        assert bounded_real_margin(system, norm * (1 + 1e-6)) > 0
        assert bounded_real_margin(system, norm * 0.999) is None


def test_energy_of_the_solution_is_the_worst_game():
    # at gamma, x' P_i x is the largest E sum |z|^2 - gamma^2 |w|^2 from x in mode i: no other policy does better
    system = random_mjls(7)
    gamma = 1.2 * hinf_norm(system)
    A, B, C, D, transition = system.matrices
    policy = solve_bounded_real(system.matrices, gamma**2)
    rng = np.random.default_rng(0)

    for scale in (0.0, 0.01, 0.03):
        F = policy.F + scale * rng.standard_normal(policy.F.shape)
        closed, output = A + B @ F, C + D @ F
        weight = output.transpose(0, 2, 1) @ output - gamma**2 * F.transpose(0, 2, 1) @ F
        assert MJLS(A=closed, B=B, C=C, transition=transition).radius() < 1.0
        value = Resolvent(closed, transition).cost(weight)
        assert np.linalg.eigvalsh(policy.P - value).min() > -1e-8 * np.abs(policy.P).max()
        if scale == 0.0:
            assert np.allclose(value, policy.P, rtol=1e-7)


def test_published_motor_gains_have_their_published_norm_on_the_correct_model():
    assert round(hinf_norm(loop(MOTOR, PRINTED_HINF, "sum")), 3) == 17.405  # printed 17.4085
    printed_model = loop(PRINTED_MOTOR, PRINTED_HINF, "sum")
    assert round(hinf_norm(printed_model), 1) == 8.1


def test_printed_motor_matrices_are_no_discretisation_of_the_plant():
    # a zero-order hold has eigenvalues 1 and exp(-3.5287 T); with 1.00023 and 0.00002 no T fits
    eigenvalues = np.sort(np.linalg.eigvals(PRINTED_MOTOR[0]))
    assert np.allclose(eigenvalues, [0.00002, 1.00023], atol=5e-6)
    assert abs(eigenvalues[1] - 1.0) > 2e-4
    assert -np.log(eigenvalues[0]) / 3.5287 > 3.0  # the T that the other eigenvalue would need, in s


def test_published_vtol_gains_are_better_than_printed():
    assert round(hinf_norm(loop(VTOL, PRINTED_VTOL_HINF, "sum", VTOL_R)), 4) == 0.3390  # printed 0.3464
    assert round(hinf_norm(loop(VTOL, PRINTED_VTOL_HINF, "stacked", VTOL_R)), 4) == 0.3353


def test_value_iteration_stalls_where_the_fold_does_not():
    # DEVIATION test: 0.3406 by value iteration on the recursion, 0.3390 by Newton at the fold
    system = loop(VTOL, PRINTED_VTOL_HINF, "sum", VTOL_R)
    A, B, C, _, transition = system.matrices
    square, P = 0.3406**2, np.zeros_like(A)
    for _ in range(400):
        E = expect(transition, P)
        BE = B.transpose(0, 2, 1) @ E
        V = square * np.eye(B.shape[2]) - BE @ B
        P_new = A.transpose(0, 2, 1) @ (E + BE.transpose(0, 2, 1) @ np.linalg.solve(V, BE)) @ A + C.transpose(0, 2, 1) @ C
        change, P = np.abs(P_new - P).max() / np.abs(P_new).max(), P_new
    assert change > 1e-6  # still moving although 0.3406 is above the norm


def test_sum_output_can_hide_a_large_norm():
    # the stacked norm bounds the norm from w to y; the sum's does not
    gains = PRINTED_VTOL_HINF
    to_output = loop_structure(*VTOL, LAMBDA, PI, "generated", R=[0.0, 0.0]).system(gains)
    assert hinf_norm(to_output) <= hinf_norm(loop(VTOL, gains, "stacked", VTOL_R))


def test_refined_fold_of_a_neighbour_is_the_fold_found_from_nothing():
    first = locate_norm(loop(MOTOR, PRINTED_HINF).matrices)
    other = loop(MOTOR, PRINTED_H2)
    refined, fresh = refine_fold(other.matrices, first), locate_norm(other.matrices)
    assert isinstance(fresh, Fold) and refined is not None
    assert np.isclose(refined.norm, fresh.norm, rtol=1e-10)


@pytest.mark.parametrize("plant, gains, R", [(MOTOR, PRINTED_HINF, 0.01), (VTOL, PRINTED_VTOL_HINF, VTOL_R)])
def test_a_solution_far_above_the_fold_predicts_it(plant, gains, R):
    """Newton's method starts from there: from the solution itself it ends nowhere, at 1.15 as at 1.2 times the norm."""
    matrices = loop(plant, gains, R=R).matrices
    fold = locate_norm(matrices)
    assert isinstance(fold, Fold)
    square = 1.15**2 * fold.square
    policy = solve_bounded_real(matrices, square)
    found = refine_fold(matrices, predict_fold(matrices, square, policy))
    assert found is not None and np.isclose(found.norm, fold.norm, rtol=1e-11)
    near = 1.001**2 * fold.square
    guess = predict_fold(matrices, near, solve_bounded_real(matrices, near))
    assert np.isclose(guess.square, fold.square, rtol=2e-4)  # a tenth of what it is above
    assert np.abs(guess.policy.P - fold.policy.P).max() < 0.01 * np.abs(fold.policy.P).max()


def test_from_a_solution_above_the_norm_is_found_too():
    matrices = loop(VTOL, PRINTED_VTOL_HINF, R=VTOL_R).matrices
    fresh = locate_norm(matrices)
    for factor in (1.0001, 1.3, 40.0):
        square = factor**2 * fresh.square
        found = locate_norm(matrices, (square, solve_bounded_real(matrices, square)))
        assert isinstance(found, Fold) and np.isclose(found.norm, fresh.norm, rtol=1e-11)


def test_no_fold_is_predicted_where_there_is_none():
    """The norm of one step of memory is reached where V is singular, and P does not depend on gamma."""
    system = MJLS(A=np.zeros((1, 1, 1)), B=[[1.0]], C=[[1.0]], transition=[[1.0]])
    policy = solve_bounded_real(system.matrices, 4.0)
    assert predict_fold(system.matrices, 4.0, policy) is None
    assert np.isclose(hinf_norm(system), 1.0, rtol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_norm_is_found_where_the_radius_is_almost_one(seed):
    """Rounding then keeps Newton's steps above what ends it elsewhere: gammas above the norm were said to be below it."""
    slow = 1e-6
    basis = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    weights = np.array([[np.sqrt(slow), 1.0, 1.0]])
    system = MJLS(
        A=(basis @ np.diag([1.0 - slow, 0.6, -0.3]) @ basis.T)[None], B=basis @ weights.T, C=weights @ basis.T, transition=[[1.0]]
    )
    norm = 1.0 + 1.0 / 0.4 + 1.0 / 1.3  # at frequency zero the three parts add up
    assert np.isclose(hinf_norm(system), norm, rtol=1e-7)
    assert solve_bounded_real(system.matrices, (0.99 * norm) ** 2) is None
    for factor in (1.01, 1.1, 2.0):
        assert solve_bounded_real(system.matrices, (factor * norm) ** 2) is not None


def test_fold_derivative_is_the_difference_quotient():
    structure = loop_structure(*VTOL, LAMBDA, PI, "generated", R=VTOL_R)
    fold = locate_norm(structure.system(PRINTED_VTOL_HINF).matrices)
    slope = structure.gain_gradient(fold.gradient_A(structure.transition))
    step = 1e-5 * np.random.default_rng(0).standard_normal(slope.shape)
    quotient = (
        hinf_norm(structure.system(PRINTED_VTOL_HINF + step)) - hinf_norm(structure.system(PRINTED_VTOL_HINF - step))
    ) / 2
    assert np.isclose(quotient, np.sum(slope * step), rtol=1e-4)


def test_norm_of_an_unstable_system_is_refused_with_its_radius():
    system = MJLS(A=[[[1.1]]], B=[[1.0]], C=[[1.0]], transition=[[1.0]])
    with pytest.raises(NotStable, match=r"radius 1\.21") as caught:
        hinf_norm(system)
    assert np.isclose(caught.value.value, 1.21)


def test_certificate_carries_the_norm_and_a_strict_inequality():
    certificate = certify_loop(*MOTOR, LAMBDA, PI, PRINTED_HINF, "generated", hinf=True)
    assert certificate.hinf_margin > 0
    assert certificate.h2_norm < certificate.hinf_norm
    assert certificate.to_json()["hinf_norm"] == certificate.hinf_norm
    assert np.isclose(certificate.h2_norm, h2_norm(loop(MOTOR, PRINTED_HINF)))
