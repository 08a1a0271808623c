"""The VTOL of Chapter 3, with a delay inside."""

import math

import numpy as np
import pytest
import scipy.linalg

from plants.parts.delayed_run import delay_ns
from plants.parts.semi_markov import TransitionRates
from plants.vtol import DelayedVTOL, vtol_matrices

STAY = TransitionRates(nodes_s=(0.0,), rates=(((0.0,) * 3,) * 3,))
QUIET = {"noise_std": 0.0, "rates": STAY}
A, B = (np.array(M) for M in vtol_matrices(135))
X0 = np.array([10.0, 6.0, 1.0, -7.0])
U = np.array([0.5, -0.2])


def after(plant, seconds, pieces=1, seed=0, u=U):
    run = plant.start(np.random.default_rng(seed))
    for _ in range(pieces):
        run.advance(round(seconds * 1e9) // pieces, tuple(u))
    return np.array(run.state[:4])


def constant_delay(seconds):
    """x(t) for tau = 0.15 s by the method of steps: every further delay is one more block of one exponential.

    With x_j(s) = x(s + 0.15 (j-1)), s in [0, 0.15]: x_1' = A x_1 + 0.1 A x_0 + B u and x_j' = A x_j + 0.1 A x_(j-1) + B u.
    """
    blocks = math.ceil(seconds / 0.15)
    n = 4 * blocks
    M = np.zeros((n + 1, n + 1))
    start = X0
    for j in range(blocks):
        rows = slice(4 * j, 4 * j + 4)
        M[rows, rows] = A
        M[rows, n] = B @ U
        if j:
            M[rows, 4 * j - 4 : 4 * j] = 0.1 * A
        else:
            M[rows, n] += 0.1 * A @ X0
    # the start of a block is the end of the one before; solve for them one after the other
    starts = [X0]
    for _ in range(1, blocks):
        k = 4 * len(starts)
        sub = np.zeros((k + 1, k + 1))
        sub[:k, :k], sub[:k, k] = M[:k, :k], M[:k, n]
        starts.append((scipy.linalg.expm(0.15 * sub) @ np.concatenate([*starts, [1.0]]))[k - 4 : k])
    rest = seconds - 0.15 * (blocks - 1)
    start = np.concatenate([*starts, [1.0]])
    return (scipy.linalg.expm(rest * M) @ start)[n - 4 : n]


@pytest.mark.parametrize("seconds", [0.1, 0.15, 0.4, 0.9])
def test_a_constant_delay_agrees_with_the_method_of_steps(seconds):
    plant = DelayedVTOL(delay_rates=(0.0, 0.0, 0.0), **QUIET)
    assert delay_ns(plant.max_delay_s, plant.delay_rates[0], 123) == 150_000_000
    np.testing.assert_allclose(after(plant, seconds), constant_delay(seconds), atol=3e-6)


def test_while_the_past_is_constant_the_motion_is_exact():
    plant = DelayedVTOL(delay_rates=(0.0, 0.0, 0.0), substep_s=0.01, **QUIET)
    np.testing.assert_allclose(after(plant, 0.15), constant_delay(0.15), rtol=1e-13)


def test_a_delay_that_is_almost_none_gives_the_plant_without_one():
    """The delay is shorter than the sub-step, so that every sub-step needs its own end."""
    plant = DelayedVTOL(max_delay_s=1e-9, delay_rates=(0.0, 0.0, 0.0), **QUIET)
    M = np.zeros((5, 5))
    M[:4, :4], M[:4, 4] = 1.1 * A, B @ U
    expected = (scipy.linalg.expm(M) @ np.append(X0, 1.0))[:4]
    np.testing.assert_allclose(after(plant, 1.0), expected, rtol=2e-5)


def errors(substeps_s, **parameters):
    """Errors after 3 s of the delay of (3.43), which touches 0 and 0.3 s, against a sub-step of 0.1 ms, over the size of x."""
    reference = after(DelayedVTOL(substep_s=0.0001, **parameters), 3.0, seed=2)
    found = [after(DelayedVTOL(substep_s=h, **parameters), 3.0, seed=2) - reference for h in substeps_s]
    return [float(np.abs(error).max() / np.abs(reference).max()) for error in found]


def test_the_error_falls_with_the_square_of_the_sub_step():
    coarse, fine = errors((0.004, 0.001), **QUIET)
    assert 8.0 < coarse / fine < 32.0
    assert fine < 1e-8


def test_the_error_is_small_through_jumps_and_noise():
    """A kink of the past that falls into a sub-step disturbs the order, not the size."""
    coarse, fine = errors((0.008, 0.001))
    assert fine < 1e-7
    assert coarse / fine > 8.0


def test_cutting_time_at_sub_steps_changes_nothing():
    plant = DelayedVTOL()
    np.testing.assert_array_equal(after(plant, 2.0, seed=5), after(plant, 2.0, pieces=40, seed=5))


def test_cutting_time_anywhere_changes_less_than_the_error():
    plant = DelayedVTOL()
    whole = after(plant, 2.0, seed=5)
    np.testing.assert_allclose(after(plant, 2.0, pieces=32 * 9, seed=5), whole, atol=1e-7 * np.abs(whole).max())


def test_the_delay_stays_in_its_bounds_and_follows_its_rate():
    plant = DelayedVTOL()
    t = np.arange(0, 10_000_000_000, 1_000_003)
    for rate in plant.delay_rates:
        delays = np.array([delay_ns(plant.max_delay_s, rate, int(k)) for k in t])
        assert delays.min() >= 0
        assert delays.max() <= 300_000_000
        slopes = np.diff(delays) / np.diff(t)
        assert np.abs(slopes).max() == pytest.approx(rate, rel=1e-3)


def test_the_history_is_kept_as_long_as_it_is_needed_and_no_longer():
    run = DelayedVTOL().start(np.random.default_rng(0))
    for _ in range(1000):
        run.advance(10_000_000, (0.0, 0.0))
        assert run._instants[0] <= max(0, run._now_ns - 300_000_000)
    assert len(run._instants) < 4000


def test_the_measurement_is_the_state_and_the_mode():
    run = DelayedVTOL().start(np.random.default_rng(1))
    modes = set()
    for _ in range(400):
        run.advance(20_000_000, (0.0, 0.0))
        assert run.measure() == run.state[:5]
        modes.add(run.measure()[4])
        assert 0.0 <= run.state[5] <= 0.3
    assert modes == {1.0, 2.0, 3.0}


GAINS = {
    (1, False): [[-1.3653, -0.5117, 0.4511, 2.6099], [-0.4102, -0.0651, -0.0271, 0.2903]],
    (2, False): [[-1.3254, -0.4512, 0.4183, 2.4012], [0.1892, 0.1996, -0.1840, -0.8173]],
    (3, False): [[-1.2800, -0.4908, 0.5168, 2.6215], [-0.4687, -0.0820, 0.0778, 0.5266]],
    (1, True): [[-2.7621, -0.6190, 0.5728, 3.4891], [-0.8064, -0.0701, 0.0010, 0.4413]],
    (2, True): [[-2.6281, -0.5833, 0.5576, 3.2410], [1.4161, 0.5205, -0.3996, -2.3219]],
    (3, True): [[-2.9429, -0.6438, 0.6372, 3.6782], [-0.6803, 0.0019, 0.0156, 0.2481]],
}


def test_the_published_gains_give_the_known_transient():
    """Chapter 3 without noise: sqrt(int z^2 dt) is 0.840 on the mean; four standard errors of 20 runs, sampled every 10 ms."""
    norms = []
    for seed in range(20):
        run = DelayedVTOL(noise_std=0.0, substep_s=0.002).start(np.random.default_rng(seed))
        mode, since, total = 1.0, 0, 0.0
        for k in range(600):
            *x, now = run.measure()
            if now != mode:
                mode, since = now, k
            total += 0.01 * (0.1 * x[1]) ** 2
            rows = GAINS[int(mode), 0.01 * (k - since) > 1.8]
            run.advance(10_000_000, [sum(a * b for a, b in zip(row, x)) for row in rows])
        norms.append(math.sqrt(total))
    assert abs(np.mean(norms) - 0.840) < 4 * np.std(norms, ddof=1) / math.sqrt(20)
