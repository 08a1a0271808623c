"""Semi-Markov delays: the augmented chain has their sojourns, and gains that know the age are worth having."""

import numpy as np
import pytest
import scipy.linalg

from design.closed_loop import loop_structure
from design.h2 import h2_norm, impulse_moments
from design.semi_markov_delays import SemiMarkovDelays, discrete_weibull
from design.tracking import TrackingProblem, solve
from tests.design.chapter7 import MOTOR, PI

# The stated bursty law: 5 to 7 fresh samples, then one of age 1, then 2 to 4 of age 2.
BURSTY = SemiMarkovDelays(
    embedded=[[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    sojourns=[[0, 0, 0, 0, 1 / 3, 1 / 3, 1 / 3], [1.0], [0, 1 / 3, 1 / 3, 1 / 3]],
)
# The control: the same means (6, 1, 3), geometric sojourns, and as many ages told apart.
GEOMETRIC = SemiMarkovDelays(
    embedded=[[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    sojourns=[(5 / 6) ** np.arange(7) / 6, [1.0], (2 / 3) ** np.arange(4) / 3],
)


def problem(sc, **options):
    return TrackingProblem(A=MOTOR[0], B=MOTOR[1], C=MOTOR[2], sc=sc, ca=PI, starts=1, **options)


def joint(chain):
    ca = np.linalg.matrix_power(PI, 200)[0]
    return np.kron(chain.stationary, ca)


def three_designs(law):
    """Systems under the true law: gains that know the age, gains of the fitted chain, gains by delay tuned on the law."""
    by_age, by_delay = law.chain(), law.chain(by_age=False)
    aged = solve(problem(by_age, initial=joint(by_age)))
    fitted = solve(problem(law.fitted()))
    tuned = solve(problem(by_delay, initial=joint(by_delay)))
    true = loop_structure(*MOTOR, by_delay, PI, "applied")
    return aged.problem.structure().system(aged.gains), true.system(fitted.gains), true.system(tuned.gains), joint(by_age)


def test_augmented_chain_has_the_sojourns_and_the_order_of_the_law():
    mode, age = BURSTY.states()
    assert (mode.tolist(), age.tolist()) == ([0] * 7 + [1] + [2] * 4, [1, 2, 3, 4, 5, 6, 7, 1, 1, 2, 3, 4])
    chain = BURSTY.chain()
    rng = np.random.default_rng(0)
    state, path = 0, []
    for _ in range(30_000):
        path.append(chain.delay[state])
        state = rng.choice(chain.modes, p=chain.matrix[state])
    runs = np.split(path, np.flatnonzero(np.diff(path)) + 1)[1:-1]
    lengths = [len(r) for r in runs if r[0] == 0]
    share = np.bincount(lengths, minlength=8)[5:8] / len(lengths)
    assert set(lengths) == {5, 6, 7}
    assert np.abs(share - 1 / 3).max() < 4.5 * np.sqrt(2 / 9 / len(lengths))  # error rate below 1e-4
    assert np.allclose(np.bincount(chain.delay, weights=chain.stationary), [0.6, 0.1, 0.3])


def test_geometric_sojourns_are_a_plain_chain():
    plain = SemiMarkovDelays(embedded=[[0, 1, 0], [0, 0, 1], [1, 0, 0]], sojourns=[[1 / 6], [1.0], [1 / 3]])
    assert np.allclose(plain.chain().matrix, [[5 / 6, 1 / 6, 0], [0, 0, 1], [1 / 3, 0, 2 / 3]])
    assert np.allclose(plain.fitted().matrix, plain.chain().matrix)
    assert all(np.allclose(q, q[0]) for q in GEOMETRIC.hazards)


def test_fitted_chain_has_the_one_step_frequencies_of_the_law():
    assert np.allclose(BURSTY.fitted().matrix, [[5 / 6, 1 / 6, 0], [0, 0, 1], [1 / 3, 0, 2 / 3]])


def test_weibull_sojourns_sum_to_one_and_shape_one_is_geometric():
    assert np.isclose(discrete_weibull(3.0, 2.0).sum(), 1.0)
    law = discrete_weibull(2.0, 1.0)
    assert np.allclose(law[1:20] / law[:19], np.exp(-0.5))


def test_shared_ages_bound_the_number_of_gains():
    assert BURSTY.chain(ages=2).label.max() == 4  # 2 + 1 + 2 labels
    assert solve(problem(BURSTY.chain(ages=2))).gains.shape == (5, 2, 1, 1)


def test_age_augmented_design_is_eight_percent_better_than_the_fitted_chain_s():
    aged, fitted, tuned, alpha = three_designs(BURSTY)
    norms = [h2_norm(system, alpha) for system in (aged, fitted, tuned)]
    assert norms[0] <= 0.92 * norms[1]
    assert norms[0] <= 0.92 * norms[2]  # nor is it the fit that is to blame
    # the control: geometric sojourns of the same means. Knowing the age is worth something there too (it tells how long
    # the state has been driven by one delay), so only what goes beyond that is due to the shape of the law.
    aged, fitted, _, alpha = three_designs(GEOMETRIC)
    control = h2_norm(aged, alpha) / h2_norm(fitted, alpha)
    assert 0.90 < control < 0.94
    assert norms[0] / norms[1] <= 0.92 * control


def test_benefit_is_seen_in_a_monte_carlo():
    aged, fitted, _, alpha = three_designs(BURSTY)
    exact = [h2_norm(s, alpha) for s in (aged, fitted)]
    energies = np.array(impulse_energies((aged, fitted), alpha, runs=4000, steps=160, seed=3))
    mean = energies.mean(axis=1)
    error = energies.std(axis=1) / np.sqrt(energies.shape[1])
    assert np.all(np.abs(mean - np.square(exact)) < 4 * error)  # two tests, error rate about 1e-4
    # paired difference of the energies: ours is below 0.92^2 of the fitted one's, with 99.9 % confidence
    difference = energies[0] - 0.92**2 * energies[1]
    assert difference.mean() + 3.1 * difference.std() / np.sqrt(difference.size) < 0


def impulse_energies(systems, alpha, runs, steps, seed):
    """sum |z(k)|^2 of impulse responses; both systems meet the same modes."""
    rng = np.random.default_rng(seed)
    transition = systems[0].matrices[4]
    cumulative = transition.cumsum(axis=1)
    mode = rng.choice(len(alpha), p=alpha, size=runs)
    states = [np.einsum("rnq->rn", s.matrices[1][mode]) for s in systems]
    energies = [np.zeros(runs) for _ in systems]
    for _ in range(steps):
        mode = np.minimum((rng.random(runs)[:, None] > cumulative[mode]).sum(axis=1), len(alpha) - 1)
        for i, system in enumerate(systems):
            A, _, C, _, _ = system.matrices
            energies[i] += np.sum(np.einsum("rln,rn->rl", C[mode], states[i]) ** 2, axis=1)
            states[i] = np.einsum("rmn,rn->rm", A[mode], states[i])
    return energies


def test_joint_distribution_starts_the_impulse_where_the_chain_is():
    chain = BURSTY.chain()
    moments = impulse_moments(np.ones((chain.modes * 2, 1, 1)), np.kron(chain.matrix, PI), joint(chain))
    assert np.allclose(moments[:, 0, 0], joint(chain))  # stationary stays stationary


def test_one_mode_equations_hold_on_the_augmented_chain():
    # a deterministic cycle of modes is a periodic system, whose norm is that of its monodromy
    law = SemiMarkovDelays(embedded=[[0, 1], [1, 0]], sojourns=[[0, 1.0], [1.0]])
    chain = law.chain()
    loop = loop_structure([[0.9]], [[1.0]], [[1.0]], chain, [[1.0]], "constant", R=0.0)
    system = loop.system(np.full(loop.gain_shape, -0.3))
    A, _, C, _, _ = system.matrices
    assert np.array_equal(chain.matrix, [[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    after_impulse = [np.eye(A.shape[1]), A[1], A[2] @ A[1]]  # modes 1, 2, 0, .. follow the impulse in mode 0
    energy = sum(M.T @ C[0].T @ C[0] @ M for M in after_impulse)
    cycle = A[0] @ A[2] @ A[1]
    gram = scipy.linalg.solve_discrete_lyapunov(cycle.T, energy)
    start = system.matrices[1][0]
    assert np.isclose(h2_norm(system, [1.0, 0, 0]) ** 2, np.trace(start.T @ gram @ start))


@pytest.mark.parametrize(
    "change, message",
    [
        ({"embedded": [[0.5, 0.5], [1, 0]]}, r"embedded\[0\]\[0\]: 0.5, expected 0"),
        ({"embedded": [[0, 0.9], [1, 0]]}, r"embedded\[0\]: row sums to 0.9"),
        ({"sojourns": [[1.0]]}, "sojourns: 1 laws, expected one per mode, 2"),
        ({"sojourns": [[1.0], [0.7, 0.7]]}, r"sojourns\[1\]: expected probabilities"),
        ({"delays": [0, -1]}, "delays: expected 2 integers >= 0"),
    ],
)
def test_faulty_laws_are_refused_by_field(change, message):
    with pytest.raises(ValueError, match="^" + message):
        SemiMarkovDelays(**({"embedded": [[0, 1], [1, 0]], "sojourns": [[1.0], [1.0]]} | change))
