"""Discrete-time batches: energies as predicted, their mean the H2 norm squared. Seeds fixed, error rates stated."""

from __future__ import annotations

import numpy as np
import pytest

from design.jump_linear import MJLS, h2_norm
from design.monte_carlo.studies import CHUNK, mjls_energies
from design.networked_loop.closed_loop import loop_structure
from tests.design.chapter7 import LAMBDA, MOTOR, PI, PRINTED_HINF

PAIR = MJLS(
    A=np.array([[[0.9, 0.4], [-0.3, 0.7]], [[0.5, -0.6], [0.2, 1.05]]]),
    B=np.array([[[1.0, 0.0], [0.2, 0.5]], [[0.3, 0.0], [0.0, 0.1]]]),
    C=np.array([[[1.0, 0.0]], [[0.5, 1.0]]]),
    D=np.array([[[0.1, 0.2]], [[0.0, 0.4]]]),
    transition=np.array([[0.8, 0.2], [0.5, 0.5]]),
)
START = np.array([1.0, -2.0])


@pytest.mark.parametrize("steps", [1, 2, 8, 25])
def test_the_mean_energy_follows_the_moment_recursion(steps: int) -> None:
    """E sum |z|^2 = sum_k tr C_i X_i C_i', X_j(k+1) = sum_i p_ij A_i X_i A_i'."""
    runs, alpha = 20_000, np.array([0.3, 0.7])
    A, _, C, _, P = PAIR.matrices
    X, want = alpha[:, None, None] * np.outer(START, START), 0.0
    for _ in range(steps):
        want += float(np.trace(C @ X @ C.transpose(0, 2, 1), axis1=1, axis2=2).sum())
        X = np.einsum("ij,iab->jab", P, A @ X @ A.transpose(0, 2, 1))
    found = mjls_energies(PAIR, runs, steps, start=START, initial=alpha, seed=5)
    assert abs(found.mean() - want) < 4.0 * found.std() / np.sqrt(runs)  # 6e-5 each


def test_energy_of_the_impulse_response_is_the_squared_h2_norm() -> None:
    alpha = np.array([1.0, 0.0])
    _, B, _, D, P = PAIR.matrices
    total, variance = 0.0, 0.0
    for column in range(2):
        # x(1) = B_{theta_0} e, and z(0) = D_{theta_0} e: start one step later, in the mode that follows
        after = mjls_energies(PAIR, 5_000, 120, start=B[0, :, column], initial=alpha @ P, seed=column)
        total += float(after.mean() + D[0, 0, column] ** 2)
        variance += float(after.var()) / 5_000
    assert abs(total - h2_norm(PAIR, alpha) ** 2) < 4.0 * np.sqrt(variance)  # 6e-5


def test_the_networked_motor_loop_loses_the_energy_that_its_h2_norm_says() -> None:
    system = loop_structure(*MOTOR, LAMBDA, PI, "generated").system(PRINTED_HINF)
    N = system.modes
    alpha = np.full(N, 1 / N)
    _, B, _, D, P = system.matrices
    np.testing.assert_array_equal(D, 0.0)
    np.testing.assert_array_equal(B, np.repeat(B[:1], N, axis=0))
    found = mjls_energies(system, 4000, 200, start=B[0, :, 0], initial=alpha @ P, seed=3)
    error = found.std() / np.sqrt(4000)
    assert abs(found.mean() - h2_norm(system, alpha) ** 2) < 4.0 * error


def test_any_split_gives_the_same_runs_bit_for_bit() -> None:
    runs, cut = 2 * CHUNK + 90, CHUNK - 13
    whole = mjls_energies(PAIR, runs, 12, start=START, seed=6)
    left = mjls_energies(PAIR, cut, 12, start=START, seed=6)
    right = mjls_energies(PAIR, runs - cut, 12, start=START, seed=6, first=cut)
    np.testing.assert_array_equal(np.concatenate([left, right]), whole)


def test_large_matrices_take_the_same_path() -> None:
    # n = 20: a tile of 512 columns would be large enough for a BLAS library to start threads.
    rng = np.random.default_rng(0)
    A = 0.2 * rng.normal(size=(2, 20, 20))
    system = MJLS(A=A, B=np.ones((20, 1)), C=np.eye(20), transition=np.array([[0.5, 0.5], [0.1, 0.9]]))
    start = rng.normal(size=20)
    two, three = (mjls_energies(system, 1, k, start=start, initial=np.array([1.0, 0.0]), seed=1)[0] for k in (2, 3))
    after = A[0] @ start
    np.testing.assert_allclose(two, start @ start + after @ after, rtol=1e-12)
    assert min(abs(two + float(np.sum((A[i] @ after) ** 2)) - three) for i in range(2)) < 1e-12 * three


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": 0}, "steps: 0"),
        ({"start": [1.0]}, "start: "),
        ({"start": [1.0, np.inf]}, "start: "),
        ({"initial": [0.5, 0.6]}, "initial: "),
        ({"seed": -1}, "seed: -1"),
        ({"runs": 0}, "runs: 0"),
    ],
)
def test_a_request_that_cannot_be_is_refused(change: dict[str, object], message: str) -> None:
    arguments = {"runs": 3, "steps": 2, "start": START} | change
    with pytest.raises(ValueError, match="^" + message):
        mjls_energies(PAIR, arguments.pop("runs"), arguments.pop("steps"), **arguments)  # type: ignore[arg-type]
