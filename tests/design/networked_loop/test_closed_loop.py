"""The augmented loop (7.14) against a loop that is run packet by packet."""

import numpy as np
import pytest

from design.networked_loop import check_gains
from design.networked_loop.closed_loop import SELECTIONS, loop_structure
from design.processes.delay_chain import DelayChain
from design.tracking import state_gains_of
from tests.design.chapter7 import LAMBDA, MOTOR, PI, VTOL

PLANTS = {"motor": MOTOR, "vtol": VTOL}
LONG_PI = np.array([[0.5, 0.5, 0.0, 0.0], [0.3, 0.3, 0.4, 0.0], [0.4, 0.2, 0.2, 0.2], [0.5, 0.1, 0.2, 0.2]])


def run_packets(plant, gains, taus, ds, selection, rows, d_before, x0, w, samples=1, integral=False, state_gains=()):
    """Plant, sensor, controller and actuator as programs that exchange packets; returns x(k) and u(k)."""
    A, B, C = plant
    x, outputs, packets, states, inputs = x0, {}, {}, [], []
    d_old, sums, xi = d_before, np.zeros(C.shape[0] * integral), np.zeros(len(state_gains[0]) if len(state_gains) else 0)
    for k, (tau, d) in enumerate(zip(taus, ds, strict=True)):
        states.append(x)
        outputs[k] = C @ x
        known = [outputs.get(k - tau - lag, np.zeros(C.shape[0])) for lag in range(samples)]
        Y = np.concatenate([*known, sums, xi])
        packets[k] = ([K @ Y for K in gains[tau]], d, d_old)
        sums, xi, d_old = sums + known[0] if integral else sums, state_gains[tau] @ Y if len(state_gains) else xi, d
        u = np.zeros(B.shape[1])
        if k - d in packets:
            sent, d_g, d_g_before = packets[k - d]
            index = {"constant": 0, "generated": d_g, "applied": d, "previous": d_g_before, "both": d_g * rows + d}
            u = sent[index[selection]]
        inputs.append(u)
        x = A @ x + B @ (u + w[k])
    return np.array(states), np.array(inputs)


def mode_path(structure, taus, ds, d_before):
    modes = {
        (s, c, b): i
        for i, (s, c, b) in enumerate(zip(structure.sc_mode, structure.ca_mode, structure.ca_before, strict=True))
    }
    before = [d_before, *ds[:-1]]
    known = structure.selection == "previous"
    return [modes[t, d, b if known else -1] for t, d, b in zip(taus, ds, before, strict=True)]


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("selection", SELECTIONS)
@pytest.mark.parametrize("Pi", [PI, LONG_PI], ids=["d_max=1", "d_max=3"])
@pytest.mark.parametrize("store, samples, integral", [("output", 1, 0), ("state", 1, 0), ("output", 2, 0.1), ("state", 4, 0)])
def test_augmented_recursion_is_the_packet_loop(plant, selection, Pi, store, samples, integral):
    rng = np.random.default_rng(7)
    A, B, C = PLANTS[plant]
    A = A * 0.9  # random gains: keep the numbers of order one
    loop = loop_structure(
        A, B / np.abs(B).max(), C, LAMBDA, Pi, selection, store=store, samples=samples, integral=integral
    )
    B = B / np.abs(B).max()
    gains = 0.1 * rng.standard_normal(loop.gain_shape)
    steps = 120
    taus, ds = rng.integers(0, 3, steps), rng.integers(0, 2, steps)
    for k in range(1, steps):  # ages of a chain: only transitions that the chains allow
        taus[k] = rng.choice(3, p=LAMBDA[taus[k - 1]])
        ds[k] = rng.choice(len(Pi), p=Pi[ds[k - 1]])
    x0, w = rng.standard_normal(A.shape[0]), 0.1 * rng.standard_normal((steps, B.shape[1]))
    states, inputs = run_packets((A, B, C), gains, taus, ds, selection, len(Pi), 0, x0, w, samples, integral > 0)
    closed, U = loop.matrices(gains), loop.applied_input(gains)
    X = np.zeros(closed.shape[1])
    X[: len(x0)] = x0
    tolerance = 1e-13 if integral else 1e-14  # the integral adds up a hundred roundings
    for k, i in enumerate(mode_path(loop, taus, ds, 0)):
        assert np.allclose(X[: len(x0)], states[k], rtol=0, atol=tolerance * max(1, np.abs(states).max()))
        assert np.allclose(U[i] @ X, inputs[k], rtol=0, atol=tolerance * max(1, np.abs(inputs).max()))
        X = closed[i] @ X + loop.B[i] @ w[k]


@pytest.mark.parametrize(("plant", "order", "samples", "integral"), [("motor", 2, 1, 0), ("vtol", 3, 2, 0), ("vtol", 3, 1, 0.1)])
@pytest.mark.parametrize("selection", SELECTIONS)
def test_a_controller_with_a_state_is_its_gains_free_or_given(plant, order, samples, integral, selection):
    """Of the VTOL's two inputs each row makes two states, and the last a single one."""
    rng = np.random.default_rng(8)
    A, B, C = PLANTS[plant]
    A, B = A * 0.9, B / np.abs(B).max()
    free = loop_structure(A, B, C, LAMBDA, PI, selection, samples=samples, order=order, integral=integral)
    gains = 0.2 * rng.standard_normal(free.gain_shape)
    rows, state_gains = state_gains_of(gains, order)
    given = loop_structure(A, B, C, LAMBDA, PI, selection, samples=samples, state_gains=state_gains, integral=integral)
    assert rows.shape[1] == given.gain_shape[1] == free.packet_rows and state_gains.shape[1] == order
    taus, ds = np.zeros(60, dtype=int), rng.integers(0, 2, 60)
    for k in range(1, 60):
        taus[k] = rng.choice(3, p=LAMBDA[taus[k - 1]])
    x0, w = rng.standard_normal(A.shape[0]), 0.1 * rng.standard_normal((60, B.shape[1]))
    states, inputs = run_packets((A, B, C), rows, taus, ds, selection, 2, 0, x0, w, samples, integral > 0, state_gains)
    assert np.array_equal(free.matrices(gains), given.matrices(rows))
    closed, U, X = given.matrices(rows), given.applied_input(rows), np.zeros(given.base.shape[-1])
    X[: len(x0)] = x0
    for k, i in enumerate(mode_path(given, taus, ds, 0)):
        for now, own, run in ((X[: len(x0)], states[k], states), (U[i] @ X, inputs[k], inputs)):
            assert np.allclose(now, own, rtol=0, atol=1e-13 * max(1.0, np.abs(run).max()))
        X = closed[i] @ X + given.B[i] @ w[k]
    weight = rng.standard_normal(free.base.shape)
    change = np.sum(weight * (free.matrices(gains) - free.base))
    assert np.isclose(change, np.sum(free.gain_gradient(weight) * gains), rtol=1e-12)


def test_stored_outputs_need_fewer_states_than_the_printed_augmentation():
    for plant, small, printed in ((MOTOR, 5, 7), (VTOL, 8, 14)):
        assert loop_structure(*plant, LAMBDA, PI).base.shape[-1] == small
        assert loop_structure(*plant, LAMBDA, PI, store="state").base.shape[-1] == printed


def test_gain_gradient_is_the_adjoint_of_the_affine_map():
    rng = np.random.default_rng(1)
    for selection in SELECTIONS:
        loop = loop_structure(*VTOL, LAMBDA, LONG_PI, selection)
        gains, weight = rng.standard_normal(loop.gain_shape), rng.standard_normal(loop.base.shape)
        change = np.sum(weight * (loop.matrices(gains) - loop.base))
        assert np.isclose(change, np.sum(loop.gain_gradient(weight) * gains), rtol=1e-12)


def test_packets_that_arrive_at_once_never_use_rows_of_another_age():
    assert loop_structure(*MOTOR, LAMBDA, PI, "both").used.tolist() == [[True, True, False, True]] * 3


def test_total_labels_share_rows():
    chain = DelayChain(transition=np.full((4, 4), 0.25), delays=[0, 1, 1, 1], labels=[0, 1, 1, 1])
    assert loop_structure(*MOTOR, LAMBDA, chain, "applied").gain_shape == (3, 2, 1, 1)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"selection": "newest"}, "selection: 'newest'"),
        ({"sc": [[0.5, 0.48], [0, 1]]}, r"Lambda\[0\]: row sums to 0.98"),
        ({"ca": [[0.5, 0.6], [0.2, 0.8]]}, r"Pi\[0\]: row sums to 1.1"),
        ({"B": np.ones((3, 1))}, "B: 3 rows, expected 2"),
        ({"C": np.ones((1, 5))}, "C: 5 columns, expected 2"),
        ({"A": np.ones((2, 3))}, r"A: shape \(2, 3\)"),
        ({"Q": np.ones((1, 3))}, r"Q: shape \(1, 3\), expected 2 columns"),
        ({"R": [[0.1, 0.2]]}, r"R: shape \(1, 2\), expected 1 columns"),
        ({"R": np.nan}, "R: not finite"),
        ({"output": "product"}, "output: 'product'"),
        ({"samples": 0}, "samples: 0"),
        ({"integral": -1.0}, "integral: -1"),
        ({"Q": np.eye(2), "output": "sum"}, "output: a sum needs"),
    ],
)
def test_wrong_shapes_are_refused_by_name(change, message):
    arguments = {"A": MOTOR[0], "B": MOTOR[1], "C": MOTOR[2], "sc": LAMBDA, "ca": PI} | change
    with pytest.raises(ValueError, match="^" + message):
        loop_structure(**arguments)


def test_gains_of_the_wrong_shape_are_refused_with_both_shapes():
    with pytest.raises(ValueError, match=r"^gains: shape \(3, 1, 1, 1\), expected \(3, 2, 1, 1\)"):
        check_gains(np.zeros((3, 1, 1, 1)), (3, 2, 1, 1))
    with pytest.raises(ValueError, match=r"^gains\[0, 1, 0, 0\]: not finite"):
        check_gains([[[[0.0]], [[np.nan]]]], (1, 2, 1, 1))
    with pytest.raises(ValueError, match=r"^gains: expected a regular nested list"):
        check_gains([[1.0], [1.0, 2.0]], (1, 2, 1, 1))


@pytest.mark.parametrize("selection", SELECTIONS)
def test_the_curvature_is_the_derivative_of_the_gradient(selection):
    """Of sum_i tr(A_i' S_i A_i X_i) / 2: its gradient S A X is affine in the gains, so that one step finds all."""
    structure = loop_structure(*VTOL, LAMBDA, LONG_PI, selection)
    rng = np.random.default_rng(3)
    cost, moments = (root @ root.swapaxes(1, 2) for root in rng.normal(size=(2, *structure.base.shape)))
    gains, used = rng.normal(size=structure.gain_shape), structure.used
    block = np.full(used.shape, -1)
    block[used] = np.arange(np.count_nonzero(used)) // 2  # two by two they are equal

    def gradient(free):
        all_gains = np.where(used[:, :, None, None], gains + free.reshape(-1, *gains.shape[2:])[block], 0.0)
        by_gain = structure.gain_gradient(cost @ structure.matrices(all_gains) @ moments)
        total = np.zeros((block.max() + 1, *gains.shape[2:]))
        np.add.at(total, block[used], by_gain[used])
        return total.ravel()

    size = (block.max() + 1) * gains.shape[2] * gains.shape[3]
    expected = np.stack([gradient(step) - gradient(0.0 * step) for step in np.eye(size)])
    found = structure.gain_curvature(cost, moments, block)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
