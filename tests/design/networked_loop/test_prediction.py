"""The predicted tracking error against ten thousand loops run packet by packet, slot by slot."""

import numpy as np
import pytest
from scipy.stats import norm

from design.controllers.gain_rows import steady_state
from design.errors import DesignError
from design.jump_linear.second_moment import congruence_matrices, forward, to_vector
from design.networked_loop import moment_recursion
from design.networked_loop.prediction import predict_tracking
from design.processes.delay_chain import DelayChain
from design.tracking.synthesis import TrackingProblem, solve
from tests.design.chapter7 import (
    LAMBDA,
    MOTOR,
    MOTOR_CONTINUOUS,
    PI,
    PRINTED_H2,
    PRINTED_HINF,
    PRINTED_VTOL_H2,
    VTOL,
    zero_order_hold,
)

PERIOD_S = 0.05
SLOTS = 700
RUNS = 10_000
RESOLUTION = 1e-14  # (1e-7 rad)^2: what float32 packets carry; below, one run in ten thousand decides the average


def schedule(slots=SLOTS, period_s=PERIOD_S):
    """A 3 rad step at 1 s and a pulse of 0.1 for two samples at 30 s, as in Section 7.4.2."""
    r, w = np.zeros(slots), np.zeros(slots)
    r[round(1 / period_s) :] = 3.0
    pulse = round(30 / period_s)
    w[pulse : pulse + 2] = 0.1
    return r, w


def stationary(P):
    return np.linalg.matrix_power(P, 300)[0]


def simulate(plant, gains, selection, r, w, runs, seed, integral=False):
    """Tracking errors (slots, runs) of single-output loops; sensor, controller and actuator exchange packets."""
    A, B, C = plant
    rng = np.random.default_rng(seed)
    tau, d = rng.choice(3, p=stationary(LAMBDA), size=runs), rng.choice(2, p=stationary(PI), size=runs)
    x, every = np.zeros((runs, A.shape[0])), np.arange(runs)
    star = steady_state(A, B, C).input[:, 0]
    ys, packets, ds, xi = [], [], [], np.zeros(runs)
    errors = np.empty((len(r), runs))
    for k in range(len(r)):
        if k:
            tau = np.minimum((rng.random(runs)[:, None] > LAMBDA.cumsum(1)[tau]).sum(axis=1), 2)
            d = np.minimum((rng.random(runs)[:, None] > PI.cumsum(1)[d]).sum(axis=1), 1)
        ys.append(x @ C[0])
        ds.append(d)
        errors[k] = ys[k] - r[k]
        e = np.stack([ys[max(k - age, 0)] for age in range(3)])[tau, every] - r[k]
        known = np.stack([e, xi], axis=1) if integral else e[:, None]
        rows = star * r[k] + np.einsum("agmp,ap->agm", gains[tau], known)
        rows[tau > k] = 0.0  # no sample has come
        xi = xi + np.where(tau > k, 0.0, e)
        packets.append(rows)
        sent = np.stack([packets[max(k - age, 0)] for age in range(2)])[d, every]
        row = {"generated": np.where(d == 0, d, ds[max(k - 1, 0)]), "applied": d, "constant": 0 * d}[selection]
        u = sent[every, row]
        u[d > k] = 0.0  # no packet has come
        x = x @ A.T + (u + w[k]) @ B.T
    return errors


def sixth_and_eighth_moments(plant, gains, selection, r, w):
    """E |e|^6 and E |e|^8 at every slot: the lifted recursion once more, for exact standard errors of the variance."""
    from design.networked_loop.closed_loop import loop_structure

    loop = loop_structure(*plant, LAMBDA, PI, selection)
    closed, order = loop.matrices(gains), loop.base.shape[-1]
    affine = np.zeros((len(closed), order + 1, order + 1))
    affine[:, :-1, :-1], affine[:, -1, -1] = closed, 1.0
    first = np.flatnonzero(r)[0]
    X = np.zeros(order + 1)
    X[-1] = 1.0
    assert not w[: first + 1].any()
    star = steady_state(*plant)
    X[: plant[0].shape[0]] = -star.state[:, 0] * r[first]
    at = plant[0].shape[0]
    X[at : at + 2] = -r[first]
    eta = to_vector(np.outer(X, X))
    zeta = to_vector(np.outer(eta, eta))
    weight = np.kron(stationary(LAMBDA), stationary(PI))
    M = weight[:, None, None] * np.outer(zeta, zeta)
    G = np.append(np.append(plant[2][0], np.zeros(order - at)), 0.0)
    q = to_vector(np.outer(G, G))
    one = np.eye(len(q))[-1]
    q2, q1 = to_vector(np.outer(q, q)), to_vector(0.5 * (np.outer(q, one) + np.outer(one, q)))
    lifted = {}
    found = np.zeros((len(r), 2))
    for k in range(first, len(r)):
        found[k] = q1 @ M.sum(axis=0) @ q2, q2 @ M.sum(axis=0) @ q2
        key = w[k]
        if key not in lifted:
            affine[:, :-1, -1] = loop.B[:, :, 0] * w[k]
            W = congruence_matrices(affine.transpose(0, 2, 1))
            lifted[key] = congruence_matrices(W.transpose(0, 2, 1))
        M = forward(lifted[key], loop.transition, M)
    return found


@pytest.mark.parametrize("gains, selection", [(PRINTED_HINF, "generated"), (PRINTED_H2, "applied")])
def test_mean_of_the_squared_error_lies_in_simultaneous_bands_at_every_slot(gains, selection):
    r, w = schedule()
    predicted = predict_tracking(*MOTOR, LAMBDA, PI, gains, selection, r, period_s=PERIOD_S, disturbance=w)
    squares = simulate(MOTOR, gains, selection, r, w, RUNS, seed=1) ** 2
    z = norm.isf(0.001 / 2 / SLOTS)  # 99.9 % for all slots at once
    band = z * predicted.square_sd / np.sqrt(RUNS) + 1e-12 * predicted.square_mean + RESOLUTION
    assert np.all(np.abs(squares.mean(axis=1) - predicted.square_mean) <= band)
    sums = PERIOD_S * squares.sum(axis=0)
    total = predicted.sum_mean[0], predicted.sum_sd[0]
    assert abs(sums.mean() - total[0]) < 3.3 * total[1] / np.sqrt(RUNS)
    assert abs(sums.std() / total[1] - 1) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("gains, selection", [(PRINTED_HINF, "generated")])
def test_variance_of_the_squared_error_lies_in_simultaneous_bands_at_every_slot(gains, selection):
    r, w = schedule()
    predicted = predict_tracking(*MOTOR, LAMBDA, PI, gains, selection, r, period_s=PERIOD_S, disturbance=w)
    squares = simulate(MOTOR, gains, selection, r, w, RUNS, seed=2) ** 2
    deviation = (squares - predicted.square_mean[:, None]) ** 2
    m1, v = predicted.square_mean, predicted.square_sd**2
    m2 = v + m1**2
    m3, m4 = sixth_and_eighth_moments(MOTOR, gains, selection, r, w).T
    spread = np.maximum(m4 - 4 * m1 * m3 + 6 * m1**2 * m2 - 3 * m1**4 - v**2, 0.0)
    z = norm.isf(0.001 / 2 / SLOTS)
    band = z * np.sqrt(spread / RUNS) + 1e-10 * m2 + RESOLUTION**2
    assert np.all(np.abs(deviation.mean(axis=1) - v) <= band)


def test_table_7_2_is_predicted_with_its_spread():
    # mean (sd) over 10,000 emulated runs: 12.03 (0.41) / 0.0305 (0.0058) at 0.05 s, 11.41 (0.20) / 0.0060 (0.0007) at 0.025 s
    expected = {
        (0.05, "hinf"): (12.03, 0.41, 0.0305, 0.0058), (0.05, "h2"): (12.33, 0.46, 0.0302, 0.0058),
        (0.025, "hinf"): (11.41, 0.20, 0.0060, 0.0007), (0.025, "h2"): (11.35, 0.18, 0.0049, 0.0006),
    }  # fmt: skip
    for (period_s, name), numbers in expected.items():
        plant = (*zero_order_hold(*MOTOR_CONTINUOUS, period_s), MOTOR[2])
        r, w = schedule(round(50 / period_s), period_s)
        predicted = predict_tracking(
            *plant, LAMBDA, PI, PRINTED_HINF if name == "hinf" else PRINTED_H2, "generated", r, period_s=period_s,
            disturbance=w, target=np.full_like(r, 3.0), sums_from=(0, round(5 / period_s)),
        )  # fmt: skip
        found = [predicted.sum_mean[0], predicted.sum_sd[0], predicted.sum_mean[1], predicted.sum_sd[1]]
        assert np.allclose(found, numbers, rtol=0.03, atol=6e-5)
    known = {"period_s": PERIOD_S, "disturbance": schedule(60)[1]}
    r = schedule(60)[0]
    loop = (*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", r)
    to_r, to_3 = (predict_tracking(*loop, target=aim, **known) for aim in (r, 3.0 + 0.0 * r))
    assert np.allclose(to_3.error_mean, to_r.error_mean + r[:, None] - 3.0) and np.allclose(to_3.error_sd, to_r.error_sd)


def test_first_packets_and_a_reference_from_the_start_are_in_the_prediction():
    # the VTOL needs an input to hold its reference, and gets none before the first packet
    r, w = np.ones(120), np.zeros(120)
    gains = PRINTED_VTOL_H2
    predicted = predict_tracking(*VTOL, LAMBDA, PI, gains, "generated", r, period_s=0.01)
    errors = simulate(VTOL, gains, "generated", r, w, 4000, seed=5)
    z = norm.isf(0.001 / 2 / 240)
    assert np.all(np.abs(errors.mean(axis=1) - predicted.error_mean[:, 0]) <= z * predicted.error_sd[:, 0] / 63.2 + 1e-9)
    assert np.all(np.abs((errors**2).mean(axis=1) - predicted.square_mean) <= z * predicted.square_sd / 63.2 + 1e-9)


def test_integral_action_is_in_the_prediction():
    design = solve(TrackingProblem(A=MOTOR[0], B=MOTOR[1], C=MOTOR[2], sc=LAMBDA, ca=PI, integral=0.01, starts=1))
    r, w = schedule(200)
    predicted = predict_tracking(
        *MOTOR, LAMBDA, PI, design.gains, "applied", r, period_s=PERIOD_S, disturbance=w, integral=True
    )
    errors = simulate(MOTOR, design.gains, "applied", r, w, 4000, seed=6, integral=True)
    z = norm.isf(0.001 / 2 / 200)
    assert np.all(np.abs((errors**2).mean(axis=1) - predicted.square_mean) <= z * predicted.square_sd / 63.2 + 1e-12)


def test_unstable_loops_are_predicted_to_diverge():
    r, _ = schedule(400)
    predicted = predict_tracking(*MOTOR, LAMBDA, PI, np.full((3, 1, 1, 1), -0.4515), "constant", r, period_s=PERIOD_S)
    assert predicted.square_mean[-1] > 1e3 * predicted.square_mean[20]


def test_wrong_arguments_are_refused_by_name():
    r = np.ones(5)
    good = {"period_s": 0.05}
    with pytest.raises(ValueError, match=r"^gains: shape \(3, 1, 1, 1\)"):
        predict_tracking(*MOTOR, LAMBDA, PI, np.zeros((3, 1, 1, 1)), "generated", r, **good)
    with pytest.raises(ValueError, match=r"^disturbance: shape \(4, 1\), expected \(5, 1\)"):
        predict_tracking(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", r, disturbance=np.zeros(4), **good)
    with pytest.raises(ValueError, match=r"^reference: not finite"):
        predict_tracking(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", r * np.nan, **good)
    with pytest.raises(ValueError, match=r"^initial\[1\]: expected 2 probabilities"):
        predict_tracking(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", r, initial=([1, 0, 0], [0.5, 0.6]), **good)
    with pytest.raises(DesignError, match="has rank"):
        predict_tracking(np.eye(2), [[1.0], [0.0]], [[0.0, 1.0]], LAMBDA, PI, PRINTED_H2, "generated", r, **good)


@pytest.mark.parametrize(
    ("gain", "integral", "own", "errors"),
    [
        ([0.0], False, [], [-1.0, -1.0, -1.0, -0.5, -0.25]),  # u* = 1/2, but for the slots in which nothing has come yet
        ([0.0, -0.1], True, [], [-1.0, -1.0, -1.0, -0.5, -0.15, 0.125]),  # u = u* - xi/10: the first known error adds in slot 2
        ([0.0, -0.1], False, [1.0, 1.0], [-1.0, -1.0, -1.0, -0.5, -0.15, 0.125]),  # the same sum, as a state of its own
        ([0.0, -0.1, 0.2], True, [0.5, 1.0, 0.5], [-1.0, -1.0, -1.0, -0.5, -0.25, -0.275]),
    ],
)
def test_before_the_first_sample_has_come_the_input_is_zero_and_nothing_is_added(
    gain: list[float], integral: bool, own: list[float], errors: list[float]
) -> None:
    """x(k+1) = x(k)/2 + u(k), r = 1."""
    two_late, gains = DelayChain(transition=[[0, 1, 0], [0, 0, 1], [0, 0, 1]]), np.tile(gain, (3, 1, 1, 1))
    found = predict_tracking(
        [[0.5]], [[1.0]], [[1.0]], two_late, [[1.0]], gains, "constant", np.ones(len(errors)), period_s=0.1, integral=integral,
        initial=([0, 0, 1], [1]), state_gains=np.tile(own, (3, 1, 1)) if own else (),
    )  # fmt: skip
    assert found.error_mean[:, 0] == pytest.approx(errors)


@pytest.mark.parametrize("selection", ["applied", "previous"])
def test_two_cycles_in_phase_meet_in_half_of_their_pairs(selection: str) -> None:
    cycle = DelayChain(transition=[[0, 1], [1, 0]], delays=[0, 1], begins=[True, False])
    gains = np.array([[[[-0.3]], [[-0.2]]], [[[-0.1]], [[0.4]]]])
    either, *both = (
        predict_tracking([[0.9]], [[1.0]], [[1.0]], cycle, cycle, gains, selection, np.ones(6), period_s=0.1, initial=initial)
        for initial in (None, ([1, 0], [1, 0]), ([0, 1], [0, 1]))
    )
    assert both[0].error_sd.max() < 1e-6 < 1e-3 < either.error_sd.max()
    assert either.error_mean == pytest.approx(0.5 * (both[0].error_mean + both[1].error_mean))
    with pytest.raises(ValueError, match="never meet"):
        predict_tracking([[0.9]], [[1.0]], [[1.0]], cycle, cycle, gains, selection, [1.0], period_s=0.1, initial=([1, 0], [0, 1]))


@pytest.mark.parametrize("share", [0.0, 2.0])
def test_transitions_one_by_one_predict_what_all_of_them_do(monkeypatch, share):
    r, w = schedule(60)
    known = predict_tracking(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", r, period_s=PERIOD_S, disturbance=w)
    monkeypatch.setattr(moment_recursion, "SPARSE", share)
    monkeypatch.setattr(moment_recursion, "LARGE", 0)
    found = predict_tracking(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", r, period_s=PERIOD_S, disturbance=w)
    assert isinstance(moment_recursion.sparse(PI), np.ndarray) == (share == 0.0)
    for name in ("error_mean", "error_sd", "sum_mean", "sum_sd"):
        assert getattr(found, name) == pytest.approx(getattr(known, name), rel=1e-6, abs=1e-6)
