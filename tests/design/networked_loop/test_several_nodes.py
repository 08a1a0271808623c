"""Several sensor nodes, each with its own delay chain: their product, its loop, and what a design gains by every age."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from design.errors import FieldError
from design.networked_loop.certify import certify_loop, informed_probability
from design.networked_loop.closed_loop import SELECTIONS, loop_structure
from design.networked_loop.prediction import predict_tracking
from design.processes.delay_chain import MOST_MODES, DelayChain, product_chain
from design.tracking.synthesis import TrackingProblem, solve
from tests.design.chapter7 import LAMBDA, MOTOR, PI, VTOL

ANGLE = DelayChain(transition=[[0.1, 0.9], [0.2, 0.8]])
SPEED = DelayChain(transition=PI)
A, B, _ = MOTOR
C = np.eye(2)
BOTH = product_chain([ANGLE, SPEED], [[0], [1]], label_counts=(2, 2))


def run_nodes(gains, label_counts, node_ages, outputs, ds, selection, rows, x0, w):
    """Plant, nodes, controller and actuator as programs; what came before slot 0 is zero. Returns x(k)."""
    x, measured, packets, states, d_before = x0, {}, {}, [], 0
    for k, (ages, d) in enumerate(zip(node_ages, ds, strict=True)):
        states.append(x)
        measured[k] = C @ x
        y, index = np.zeros(2), 0
        for age, own, count in zip(ages, outputs, label_counts, strict=True):
            y[own] = measured.get(k - age, np.zeros(2))[own]
            index = index * count + age
        packets[k] = ([K @ y for K in gains[index]], d, d_before)
        d_before, u = d, np.zeros(1)
        if k - d in packets:
            sent, at_generation, before = packets[k - d]
            index = {"constant": 0, "generated": at_generation, "applied": d, "previous": before}
            index["both"] = at_generation * rows + d
            u = sent[index[selection]]
        x = 0.9 * A @ x + B / 8 @ (u + w[k])
    return np.array(states)


@pytest.mark.parametrize("selection", SELECTIONS)
@pytest.mark.parametrize("outputs", [([0], [1]), ([1], [0])], ids=["angle-first", "speed-first"])
def test_the_loop_of_the_product_chain_is_the_loop_of_the_nodes(selection: str, outputs: tuple[list[int], list[int]]) -> None:
    rng = np.random.default_rng(3)
    chains = (DelayChain(transition=LAMBDA), SPEED)
    sc = product_chain(chains, outputs, label_counts=(3, 2))
    loop = loop_structure(0.9 * A, B / 8, C, sc, PI, selection)
    gains = 0.3 * rng.standard_normal(loop.gain_shape)
    triples = zip(loop.sc_mode.tolist(), loop.ca_mode.tolist(), loop.ca_before.tolist(), strict=True)
    place = {triple: i for i, triple in enumerate(triples)}
    steps = 80
    path = np.zeros((steps, 3), dtype=int)
    for k in range(1, steps):
        path[k] = [rng.choice(len(M), p=M[mode]) for M, mode in zip((LAMBDA, PI, PI), path[k - 1], strict=True)]
    x0, w = rng.standard_normal(2), rng.standard_normal((steps, 1))
    states = run_nodes(gains, (3, 2), path[:, :2].tolist(), outputs, path[:, 2].tolist(), selection, 2, x0, w)
    X = np.concatenate([x0, np.zeros(loop.base.shape[-1] - 2)])
    closed, before = loop.matrices(gains), 0
    for k, (first, second, d) in enumerate(path.tolist()):
        np.testing.assert_allclose(X[:2], states[k], rtol=0, atol=1e-12 * max(1.0, np.abs(states).max()))
        i = place[first * 2 + second, d, before if selection == "previous" else -1]
        X, before = closed[i] @ X + loop.B[i] @ w[k], d


@pytest.mark.parametrize("plant", [MOTOR, VTOL], ids=["motor", "vtol"])
def test_the_product_of_one_chain_is_the_loop_of_one_sensor_bit_for_bit(plant: tuple) -> None:
    one = DelayChain(transition=LAMBDA)
    alone, product = (loop_structure(*plant, sc, PI, "applied") for sc in (one, product_chain([one], [range(len(plant[2]))])))
    for name in ("base", "B", "C", "transition", "input_base", "default_initial"):
        assert getattr(alone, name).tobytes() == getattr(product, name).tobytes(), name
    for mine, theirs in zip(alone.entries, product.entries, strict=True):
        assert mine.tobytes() == theirs.tobytes()


def test_two_nodes_of_one_age_are_one_node() -> None:
    """Node 2 has a constant delay of 0 and measures nothing new: the chain of node 1 decides, whichever node has which output."""
    gains = np.array([[[[-0.05, -0.006]]], [[[-0.04, -0.005]]], [[[-0.03, -0.004]]]])
    one = certify_loop(A, B, C, LAMBDA, PI, gains, "constant")
    same = DelayChain(transition=[[1.0]], delays=[0])
    fresh = certify_loop(A, B, C, product_chain([DelayChain(transition=LAMBDA), same], [[0, 1], []]), PI, gains, "constant")
    assert fresh.mean_square_radius == pytest.approx(one.mean_square_radius, rel=1e-9)
    late = certify_loop(A, B, C, product_chain([DelayChain(transition=LAMBDA), same], [[0], [1]]), PI, gains, "constant")
    assert abs(late.mean_square_radius - one.mean_square_radius) > 1e-3  # a speed that is never late makes another loop


def test_what_does_not_fit_is_refused() -> None:
    for outputs, label_counts, field in (
        ([[0], [0]], (), "outputs"), ([[0]], (), "outputs"), ([[0], [2]], (), "outputs"), ([[0], [1]], (2,), "label_counts"),
    ):  # fmt: skip
        with pytest.raises(FieldError) as caught:
            product_chain([ANGLE, SPEED], outputs, label_counts)
        assert caught.value.field == field
    many = DelayChain(transition=np.full((40, 40), 1 / 40))
    with pytest.raises(FieldError, match=f"1600 modes together, at most {MOST_MODES}"):
        product_chain([many, many], [[0], [1]])
    with pytest.raises(FieldError, match="2 outputs, but the plant has 1"):
        loop_structure(*MOTOR, BOTH, PI)
    with pytest.raises(FieldError, match="ages"):
        structs.replace(BOTH, ages=np.zeros((4, 2), dtype=int))


def test_a_bound_counts_the_youngest_sample_of_any_node() -> None:
    """What one node may already tell counts as known, so that the bound holds for every controller of all nodes."""
    youngest = DelayChain(transition=BOTH.matrix, delays=BOTH.ages.min(axis=1))
    ca = DelayChain(transition=PI)
    for mode in range(8):
        assert informed_probability(BOTH, ca, mode) [: 2] == informed_probability(youngest, ca, mode)[: 2]


@pytest.fixture(scope="module")
def designs():
    problem = TrackingProblem(A=A, B=B, C=C, sc=BOTH, ca=PI, Q=[[1.0, 0.0]], R=0.01, starts=1)
    oldest = product_chain([ANGLE, SPEED], [[0], [1]])
    one = DelayChain(transition=oldest.matrix, delays=oldest.delay)
    return solve(problem), solve(replace(problem, sc=oldest)), solve(replace(problem, sc=one))


def test_knowing_every_age_beats_knowing_the_oldest(designs) -> None:
    """Ours 1.108; the best by the oldest age 1.218; the design of one node, run by the oldest age, 1.310."""
    ours, by_oldest, one = designs
    sc = product_chain([ANGLE, SPEED], [[0], [1]])
    applied = certify_loop(A, B, C, sc, PI, one.gains, one.selection, Q=[[1.0, 0.0]], R=0.01)
    assert applied.stable and ours.certificate.stable
    assert ours.certificate.h2_norm < 0.95 * by_oldest.certificate.h2_norm < 0.95 * 0.95 * applied.h2_norm


def test_the_norm_of_a_design_is_the_energy_of_its_impulse_response(designs) -> None:
    """The H2 norm against the sum of E|z|^2 that the prediction gives, which is another recursion (over moments of X X')."""
    ours = designs[0]
    zero, impulse = np.zeros((400, 2)), np.zeros(400)
    impulse[5] = 1.0  # a packet of every node has come by then
    stationary = (BOTH.stationary, SPEED.stationary)
    energy = certify_loop(
        A, B, C, BOTH, PI, ours.gains, ours.selection, Q=[[1.0, 0.0]], R=np.zeros((1, 1)), initial=np.kron(*stationary)
    ).h2_norm ** 2  # fmt: skip
    label_counts = predict_tracking(
        A, B, C, BOTH, PI, ours.gains, ours.selection, zero, period_s=1.0, disturbance=impulse, initial=stationary
    )  # fmt: skip
    assert label_counts.error_mean[6] == pytest.approx(B[:, 0])
    assert float((label_counts.error_mean[:, 0] ** 2 + label_counts.error_sd[:, 0] ** 2).sum()) == pytest.approx(energy, rel=1e-6)
