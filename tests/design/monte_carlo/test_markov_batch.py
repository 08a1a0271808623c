"""Discrete-time batches: moments as predicted, energy = H2 norm squared. Seeds fixed, error rates stated."""

from __future__ import annotations

import numpy as np
import pytest

from design.jump_linear import MJLS, h2_norm
from design.monte_carlo.markov_batch import CHUNK, simulate_mjls
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


def predicted(system: MJLS, start: np.ndarray, alpha: np.ndarray, steps: int, noise: bool) -> list[np.ndarray]:
    """X_j(k+1) = sum_i p_ij (A_i X_i A_i' + pi_i B_i B_i'), summed over the modes."""
    A, B, _, _, P = system.matrices
    share, x = alpha, alpha[:, None, None] * np.outer(start, start)
    out = [x.sum(axis=0)]
    for _ in range(steps):
        step = A @ x @ A.transpose(0, 2, 1)
        if noise:
            step = step + share[:, None, None] * (B @ B.transpose(0, 2, 1))
        x, share = np.einsum("ij,iab->jab", P, step), share @ P
        out.append(x.sum(axis=0))
    return out


@pytest.mark.parametrize("noise", [False, True])
def test_second_moments_follow_the_moment_recursion(noise: bool) -> None:
    runs, steps, alpha = 20_000, 25, np.array([0.3, 0.7])
    found = simulate_mjls(PAIR, runs, steps, start=START, initial=alpha, noise=noise, seed=5)
    want = predicted(PAIR, START, alpha, steps, noise)
    np.testing.assert_allclose(found.second[0], np.outer(START, START))
    np.testing.assert_allclose(found.second[-1], found.final.T @ found.final / runs, rtol=1e-12)
    # z tests at 6e-5 for each entry at the end, with the error taken from the runs themselves
    products = found.final[:, :, None] * found.final[:, None, :]
    error = products.std(axis=0) / np.sqrt(runs)
    assert (np.abs(found.second[-1] - want[-1]) < 4.0 * error).all()
    # and all along, to the accuracy that the spread over the run allows
    for k in (3, 10):
        np.testing.assert_allclose(found.second[k], want[k], rtol=0.1, atol=0.05)
    share = alpha
    for k in range(steps + 1):
        assert (np.abs(found.occupancy[k] - share) < 4.5 * np.sqrt(0.25 / runs)).all()
        share = share @ PAIR.matrices[4]


def test_energy_of_the_impulse_response_is_the_squared_h2_norm() -> None:
    alpha = np.array([1.0, 0.0])
    _, B, _, D, P = PAIR.matrices
    total, variance = 0.0, 0.0
    for column in range(2):
        # x(1) = B_{theta_0} e, and z(0) = D_{theta_0} e: start one step later, in the mode that follows
        after = simulate_mjls(PAIR, 5_000, 120, start=B[0, :, column], initial=alpha @ P, seed=column)
        total += float(after.energy.mean() + D[0, 0, column] ** 2)
        variance += float(after.energy.var()) / 5_000
    assert abs(total - h2_norm(PAIR, alpha) ** 2) < 4.0 * np.sqrt(variance)  # 6e-5


def test_the_networked_motor_loop_loses_the_energy_that_its_h2_norm_says() -> None:
    system = loop_structure(*MOTOR, LAMBDA, PI, "generated").system(PRINTED_HINF)
    N = system.modes
    alpha = np.full(N, 1 / N)
    _, B, _, D, P = system.matrices
    np.testing.assert_array_equal(D, 0.0)
    np.testing.assert_array_equal(B, np.repeat(B[:1], N, axis=0))
    found = simulate_mjls(system, 4000, 200, start=B[0, :, 0], initial=alpha @ P, seed=3)
    error = found.energy.std() / np.sqrt(4000)
    assert abs(found.energy.mean() - h2_norm(system, alpha) ** 2) < 4.0 * error
    assert np.abs(found.final).max() < 1e-2 * np.abs(B).max()


def test_any_split_gives_the_same_runs_bit_for_bit() -> None:
    runs, cut = 2 * CHUNK + 90, CHUNK - 13
    whole = simulate_mjls(PAIR, runs, 12, start=START, noise=True, seed=6)
    left = simulate_mjls(PAIR, cut, 12, start=START, noise=True, seed=6)
    right = simulate_mjls(PAIR, runs - cut, 12, start=START, noise=True, seed=6, first=cut)
    for name in ("energy", "peak", "final"):
        both = np.concatenate([getattr(left, name), getattr(right, name)])
        np.testing.assert_array_equal(both, getattr(whole, name))


def test_large_matrices_take_the_same_path() -> None:
    # n = 20: a tile of 512 columns would be large enough for a BLAS library to start threads.
    rng = np.random.default_rng(0)
    A = 0.2 * rng.normal(size=(2, 20, 20))
    system = MJLS(A=A, B=np.ones((20, 1)), C=np.eye(20), transition=np.array([[0.5, 0.5], [0.1, 0.9]]))
    start = rng.normal(size=20)
    found = simulate_mjls(system, 1, 2, start=start, initial=np.array([1.0, 0.0]), seed=1)
    mean = found.mean
    np.testing.assert_allclose(mean[1], A[0] @ start, rtol=1e-12)
    assert min(np.abs(A[i] @ mean[1] - mean[2]).max() for i in range(2)) < 1e-12
    np.testing.assert_allclose(found.final[0], mean[2])


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
        simulate_mjls(PAIR, arguments.pop("runs"), arguments.pop("steps"), **arguments)  # type: ignore[arg-type]
