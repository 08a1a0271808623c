"""What no controller can go below: reached by the best causal one, and turned by what it knows."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from msgspec import structs

from design.controllers.sensor_nodes import SensorNodes, Turns
from design.historical_data import DelayedPlant
from design.historical_data.cost_bounds import Arrivals, arrivals_of, causal_bound, full_state_bound, mean_full_state_bound
from design.historical_data.sensor_schedule import round_robin

Array = npt.NDArray[np.float64]

PLANT = DelayedPlant(
    A=np.array([[1.1, 0.4], [0.0, 0.9]]), delayed=np.array([[[0.1, 0.0], [0.2, -0.3]]]), B=np.array([[0.0], [1.0]]),
    weight=np.eye(2), input_weight=np.array([[0.1]]),
)  # fmt: skip
NODES = SensorNodes(
    names=("a", "b"), outputs=((0,), (1,)), buffers=(2, 1), delays=(0, 0),
    turns=Turns(transition=((0.3, 0.7), (0.6, 0.4)), initial=(0.2, 0.8), loss=0.25),
)  # fmt: skip


@cache
def regulator(plant: DelayedPlant, memory: int) -> Array:
    A, B, Q, R = plant.matrices(memory)
    S = Q
    for _ in range(300):
        S = Q + A.T @ S @ A - A.T @ S @ B @ np.linalg.inv(R + B.T @ S @ B) @ B.T @ S @ A
    return np.asarray(np.linalg.inv(R + B.T @ S @ B) @ B.T @ S @ A)


def certainty_equivalent_cost(plant: DelayedPlant, seen: list[list[int]], memory: int) -> float:
    """Mean cost over x(0) ~ N(0, I) of the regulator on the conditional mean, by a literal Kalman filter on one path.

    Both are linear in x(0): the mean is the sum over the basis of x(0).
    """
    (A, B, Q, R), K = plant.matrices(memory), regulator(plant, memory)
    size, n = len(A), len(plant.A)
    X, guess, sigma, total = np.eye(size)[:, :n], np.zeros((size, n)), np.zeros((size, size)), 0.0
    sigma[:n, :n] = np.eye(n)
    for own in seen:
        gain = sigma[:, own] @ np.linalg.pinv(sigma[np.ix_(own, own)], rcond=1e-10)
        guess = guess + gain @ (X[own] - guess[own])
        sigma = sigma - gain @ sigma[own]
        u = -K @ guess
        total += float(np.sum(X * (Q @ X)) + np.sum(u * (R @ u)))
        X, guess, sigma = A @ X + B @ u, A @ guess + B @ u, A @ sigma @ A.T
    return total


def paths(arrivals: Arrivals, count: int, slots: int, memory: int) -> list[list[list[int]]]:
    rng, found = np.random.default_rng(3), []
    for _ in range(count):
        phase, own = int(rng.choice(len(arrivals.start), p=arrivals.start)), []
        for _ in range(slots):
            rows = [j * 2 + i for i, age, samples in arrivals.seen[phase] for j in range(age, min(age + samples, memory + 1))]
            own.append([] if rng.random() < arrivals.loss else rows)
            phase = int(rng.choice(len(arrivals.start), p=arrivals.transition[phase]))
        found.append(own)
    return found


def test_the_bound_over_random_lossy_turns_is_what_the_best_causal_controller_costs() -> None:
    """100 paths, a band of 99.9 %: one right bound in a thousand is refused; losses of 0.5 for 0.25 lie beyond twice the band."""
    arrivals = arrivals_of(NODES)
    assert arrivals is not None
    costs = np.array([certainty_equivalent_cost(PLANT, path, 1) for path in paths(arrivals, 100, 30, 1)])
    band = 3.29 * costs.std(ddof=1) / np.sqrt(len(costs))
    found = causal_bound(PLANT, arrivals, np.eye(2))
    assert abs(costs.mean() - found) < band
    other = causal_bound(PLANT, structs.replace(arrivals, loss=0.5), np.eye(2))
    assert abs(costs.mean() - other) > 2 * band


def test_a_chain_that_never_doubts_is_the_cycle_and_every_loss_raises_the_bound() -> None:
    turning = Turns(transition=((0.0, 1.0), (1.0, 0.0)), initial=(0.5, 0.5))
    chain = arrivals_of(structs.replace(NODES, buffers=(1, 1), turns=turning))
    assert chain is not None
    cycle, full_state = arrivals_of(round_robin(2, buffer=1)), mean_full_state_bound(PLANT, np.eye(2))
    assert cycle is not None
    found = causal_bound(PLANT, cycle, np.eye(2))
    assert causal_bound(PLANT, chain, np.eye(2)) == pytest.approx(found, rel=1e-9)
    values = [causal_bound(PLANT, structs.replace(chain, loss=loss), np.eye(2)) for loss in (0.0, 0.1, 0.3)]
    assert full_state < values[0] < values[1] < values[2]
    everything = arrivals_of(structs.replace(NODES, turns=None))
    assert everything is not None and causal_bound(PLANT, everything, np.eye(2)) == pytest.approx(full_state, rel=1e-12)


def test_a_late_packet_raises_the_bound_of_a_cycle() -> None:
    values = []
    for delay in (0, 1, 2):
        own = arrivals_of(structs.replace(NODES, delays=(delay, delay), turns=Turns(order=(0, 1))))
        assert own is not None
        values.append(causal_bound(PLANT, own, np.eye(2)))
    assert values[0] < values[1] < values[2]


@pytest.mark.parametrize(
    "change",
    [{"mixed": True}, {"unforeseen": "x"}, {"silent": ("a",)}, {"delays": (0, None)}, {"delays": (0, 1)}, {"delays": (1, 1)}],
    ids=str,
)
def test_a_schedule_that_is_no_chain_of_its_own_has_no_causal_bound(change: dict[str, object]) -> None:
    assert arrivals_of(NODES) is not None
    assert arrivals_of(structs.replace(NODES, **change)) is None  # type: ignore[arg-type]


def test_the_full_state_bound_is_reached_by_the_regulator_from_a_known_past() -> None:
    history = np.array([[1.0, -2.0], [0.5, 0.25]])
    (A, B, Q, R), K = PLANT.matrices(1), regulator(PLANT, 1)
    X, total = history.ravel(), 0.0
    for _ in range(300):
        u = -K @ X
        total += float(X @ Q @ X + u @ R @ u)
        X = A @ X + B @ u
    assert full_state_bound(PLANT, history) == pytest.approx(total, rel=1e-10)
    assert full_state_bound(PLANT, history[:1]) != pytest.approx(total, rel=1e-3)
