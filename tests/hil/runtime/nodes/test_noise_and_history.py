"""Sensor noise and a history before slot 0, on the rig and in its certificate."""

from __future__ import annotations

import numpy as np
import pytest

from design.historical_data import DelayedPlant
from design.historical_data.guaranteed_cost import close_received
from design.jump_linear.second_moment import forward
from hil.certify.historical_loop import delayed_plant_of
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.measure.cost import Cost
from hil.measure.view import view_of
from hil.rig.loop import Loop
from hil.runtime.nodes import rng_for
from hil.runtime.virtual import simulate
from plants.parts.draws import Normals

HISTORY = "plant.initial_history=[[1, 2, -3, 0.5], [0, 4, 1, 1], [2, 2, 2, 2]]"
NOISE = "plant.noise_sd=[0.1, 0.2, 0.0, 0.3]"


def cost_of(loop: Loop, seed: int = 0) -> float:
    found = Cost().of(view_of(simulate(loop, seed), loop.experiment))["cost"]
    assert found is not None
    return found


@pytest.mark.parametrize(("name", "expected"), [("published", 187.3906), ("newest", 123.8742)])
def test_a_run_from_a_history_costs_what_its_certificate_says(name: str, expected: float) -> None:
    """No sensor has seen the history: gains on it act from the slot on in which their sample has been taken."""
    loop = compose(load_experiment(f"multisensor-{name}", [HISTORY]))
    assert loop.verdict is not None and loop.verdict.details["cost"] == pytest.approx(expected, abs=1e-4)
    assert "the history before slot 0 is the plant's, not received" in loop.verdict.assumptions
    assert cost_of(loop) == pytest.approx(expected, abs=1e-3)


def literal_costs(loop: Loop, noise: np.ndarray) -> np.ndarray:
    """Cost of (5.1) under (5.17) from zero, one a run; noise: (slots, n, runs)."""
    plant, K = delayed_plant_of(loop.experiment.plant, loop.model), loop.controller.history()  # type: ignore[attr-defined]
    assert plant is not None and loop.model.sensors is not None and loop.model.sensors.turns is not None
    phase, total = loop.model.sensors.turns.phase, np.zeros(noise.shape[2])
    x = [np.zeros(noise.shape[1:])] * (plant.memory + 1)
    for k, v in enumerate(noise):
        total += np.einsum("ar,ab,br->r", x[0], plant.weight, x[0])
        u = K[(k + phase) % 4, 0] @ (x[0] + v)
        x = [plant.A @ x[0] + sum(plant.delayed[j] @ x[j + 1] for j in range(plant.memory)) + plant.B @ u, *x[:-1]]
    return total


def noise_costs(
    plant: DelayedPlant, K: np.ndarray, sd: np.ndarray, share: np.ndarray, slots: int, chain: np.ndarray | None = None
) -> np.ndarray:
    """What the noise adds to the cost in slot 0, 1, ...: the covariance of (X, Y), slot by slot."""
    loop = close_received(plant, K, chain)
    size, n = loop.L.shape[-1] - K.shape[1] * K.shape[3], len(sd)
    fresh, P, found = np.zeros(loop.L.shape[1:]), np.zeros_like(loop.L), []
    fresh[size : size + n, size : size + n] = np.diag(sd**2)
    for _ in range(slots):
        P = P + share[:, None, None] * fresh
        found.append(np.einsum("iab,iab->", loop.Q, P))
        share, P = share @ loop.transition, forward(loop.L, loop.transition, P)
    return np.array(found)


def test_noise_costs_what_is_predicted() -> None:
    """The run is (5.1) with the draws of its own stream; 2,000 literal runs: 4.4 standard errors, 5 % off would be seen."""
    slots, sd = 60, np.array([0.1, 0.2, 0.0, 0.3])
    loop = compose(load_experiment("multisensor-newest", [NOISE, "plant.initial_state=[0, 0, 0, 0]", "duration=3"]))
    drawn = np.array(Normals(rng_for(7, "plant")).several(4 * slots)).reshape(slots, 4)
    draws = (sd * drawn)[:, :, None]
    assert cost_of(loop, 7) == pytest.approx(float(literal_costs(loop, draws)[0]), rel=1e-5)
    plant, K = delayed_plant_of(loop.experiment.plant, loop.model), loop.controller.history()  # type: ignore[attr-defined]
    assert plant is not None and loop.verdict is not None
    said = noise_costs(plant, K, sd, np.eye(4)[1], 400)
    costs = literal_costs(loop, sd[:, None] * np.random.default_rng(2).standard_normal((slots, 4, 2000)))
    error = costs.std(ddof=1) / np.sqrt(len(costs))
    assert abs(costs.mean() - said[:slots].sum()) < 4.4 * error and 8.8 * error < 0.2 * said[:slots].sum()
    assert said[-4:].mean() == pytest.approx(loop.verdict.details["noise_cost_per_slot"], rel=1e-9)


def test_noise_over_random_turns_costs_what_its_slots_come_to() -> None:
    loop = compose(load_experiment("multisensor-lossy", [NOISE]))
    assert loop.verdict is not None and loop.verdict.certified
    assert any("sensor noise is white" in said for said in loop.verdict.assumptions)
    quiet = compose(load_experiment("multisensor-lossy"))
    assert quiet.verdict is not None and quiet.verdict.details["cost"] == pytest.approx(loop.verdict.details["cost"], rel=1e-12)
    assert "noise_cost_per_slot" not in quiet.verdict.details
    K, plant = loop.controller.history(), delayed_plant_of(loop.experiment.plant, loop.model)  # type: ignore[attr-defined]
    assert plant is not None
    lost = np.concatenate([K, np.zeros_like(K)])
    chain = np.kron([[0.9, 0.1]] * 2, np.full((4, 4), 0.25))
    said = noise_costs(plant, lost, np.array([0.1, 0.2, 0.0, 0.3]), chain[0], 300, chain)
    assert said[-1] == pytest.approx(loop.verdict.details["noise_cost_per_slot"], rel=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("noise_sd=[0.1, 0.1, -0.1, 0.1]", r"plant\.noise_sd\[2\]: -0\.1"),
        ("noise_sd=[0.1]", r"plant\.noise_sd: 1 entries, expected 4"),
        ("initial_history=[[1, 2, 3]]", r"plant\.initial_history\[0\]: 3 entries, expected 4"),
        ("initial_history=[[1, 2, 3, nan]]", r"plant\.initial_history\[0\]\[3\]: nan"),
        (f"initial_history={[[1.0] * 4] * 6}", r"plant\.initial_history: 6 rows, expected at most 5"),
    ],
)
def test_what_cannot_be_is_refused_by_its_path(change: str, says: str) -> None:
    with pytest.raises(HilError, match=says):
        compose(load_experiment("multisensor-newest", [f"plant.{change}"]))
