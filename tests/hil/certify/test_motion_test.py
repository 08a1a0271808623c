"""How a plant's motion is distinguished from its model's: by inputs of every size, without inputs, and by its record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from design.controllers import LoopModel
from hil.certify.conformance import LARGEST_POLYNOMIAL, one_step
from hil.certify.motion_test import SLOTS, by_size, departure, drive, foretold, free_motion, random_inputs
from plants import LinearPlant
from plants.switched_example import SwitchedExample

PLANT = LinearPlant(A=((-1.0, 0.5), (0.0, -2.0)), B=((1.0, 0.0), (0.0, 3.0)), C=((1.0, 0.5),))
PERIOD_NS = 100_000_000
UNDELAYED = np.zeros((0, 2, 2))


def model_of(plant: LinearPlant) -> LoopModel:
    found = plant.model().discretise(1e-9 * PERIOD_NS)
    return LoopModel(A=found.A, B=found.B, C=found.C, period_s=1e-9 * PERIOD_NS, tau_max=0, d_max=0)


MODEL = model_of(PLANT)


def test_inputs_reach_both_limits_change_at_once_and_rest() -> None:
    for column in random_inputs(200, 3).T:
        stays = {len(list(run)) for _, run in groupby(column.tolist())}
        assert column.max() == 1.0 and column.min() == -1.0 and min(stays) == 1 and max(stays) >= 10


def test_the_predicted_motion_is_the_recursion_with_its_delays() -> None:
    rng = np.random.default_rng(2)
    delayed, u = 0.1 * rng.normal(size=(2, 2, 2)), rng.normal(size=(6, 2))
    x = [np.zeros(2), np.zeros(2), np.zeros(2)]
    for each in u:
        x.append(MODEL.A @ x[-1] + MODEL.B @ each + delayed[0] @ x[-2] + delayed[1] @ x[-3])
    assert np.allclose(foretold(MODEL, delayed, u), x[2:])


def departed(plant: LinearPlant, model: LoopModel, size: float, bounds: Sequence[float] = (np.inf, np.inf)) -> Any:
    shape, unit = random_inputs(SLOTS, 2), np.array([1.0, 2.0])
    free = drive(plant, PERIOD_NS, np.zeros((SLOTS, 2)))
    found = departure(plant, model, foretold(model, UNDELAYED, shape * unit), free, shape, unit, size, bounds)
    return found, shape * unit * size


def test_a_wrong_model_is_reported_with_signal_slot_and_numbers() -> None:
    same, _ = departed(replace(PLANT, initial_state=(3.0, -1.0)), MODEL, 10.0)
    assert same.share < 1e-9 and same.slots == SLOTS and same.size == 10.0
    wrong = structs.replace(MODEL, A=MODEL.A @ np.diag([1.0, 1.01]))
    found, inputs = departed(PLANT, wrong, 10.0)
    moved, model = drive(PLANT, PERIOD_NS, inputs), foretold(wrong, UNDELAYED, inputs)
    assert found.signal == ("y1", "1") and 0.005 < found.share < 0.5 and found.slot == 2  # x is 0, then B u, then A B u
    assert found.found == pytest.approx(moved.outputs[2, 0]) and found.foretold == pytest.approx((model @ MODEL.C.T)[2, 0])
    bound = 0.99 * float(np.abs(model[:41, 1]).max())
    near, _ = departed(PLANT, wrong, 10.0, (np.inf, bound))
    assert near.slots == int((np.abs(model[:, 1]) >= bound).argmax()) - 1


def test_a_wrong_model_is_found_beside_a_motion_that_grows_without_bound() -> None:
    """Of e^60 at the end the first slots are nothing; there it is seen that a state rises by 1 % and does not fall by 1 %."""
    A, B, C = np.diag([1.35, 1.01]), np.ones((2, 2)), np.eye(2)
    model = structs.replace(MODEL, A=np.diag([1.35, 0.99]), B=B, C=C)
    shape = random_inputs(SLOTS, 2)

    class Moves:
        inputs = outputs = states = (("a", "1"), ("b", "1"))

        def __init__(self, A: np.ndarray) -> None:
            self.A, self.x, self.applied = A, np.zeros(2), (0.0, 0.0)

        def start(self, rng: np.random.Generator) -> Moves:
            return Moves(self.A)

        def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float]) -> None:
            self.x, self.applied = self.A @ self.x + B @ u, (u[0], u[1])

        def measure(self) -> tuple[float, ...]:
            return tuple(self.x)

        state = property(measure)

    shares = []
    for moves in (model.A, A):
        plant: Any = Moves(moves)
        free = drive(plant, PERIOD_NS, np.zeros((SLOTS, 2)))
        found = departure(plant, model, foretold(model, UNDELAYED, shape), free, shape, np.ones(2), 1.0, (np.inf, np.inf))
        shares.append(found.share)
    assert shares[0] < 1e-9 and shares[1] > 0.005


def test_an_actuator_that_applies_less_is_reported_before_the_motion() -> None:
    found, inputs = departed(replace(PLANT, saturation=(100.0, 1.5)), MODEL, 1.0)
    first = int((np.abs(inputs[:, 1]) > 1.5).argmax())
    assert found.share == np.inf and found.signal == ("applied u2", "1") and found.slot == first
    assert abs(found.found) == 1.5 and found.foretold == inputs[first, 1]


@pytest.mark.parametrize(
    ("shares", "said"),
    [((1e-7, 0.5), "is as said at small"), ((0.5, 1e-7), "is as said at large"), ((0.5, 0.02), None), ((0.05, 0.009), None),
     ((0.5, 0.5), None)],
)  # fmt: skip
def test_what_is_as_said_at_one_size_alone_is_not_linear(shares: tuple[float, float], said: str | None) -> None:
    found = by_size(shares, "is as said at {}", "is another")
    assert found == (None if said is None else ("undecided", f"non-linear: {said}, but is another"))


class Loaded:
    """A linear run on which a load acts, which grows from slot to slot."""

    def __init__(self, run: Any, growth: float) -> None:
        self._run, self._load, self._growth = run, 0.1, growth

    def __getattr__(self, name: str) -> Any:
        return getattr(self._run, name)

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        self._run.advance(dt_ns, u, (w[0] + self._load, *w[1:]))
        self._load *= self._growth


class LoadedPlant(LinearPlant):
    growth = 1.0

    def start(self, rng: np.random.Generator) -> Any:
        return Loaded(super().start(rng), self.growth)


class Swelling(LoadedPlant):
    growth = 1.1


SAID = {"A": PLANT.A, "B": PLANT.B, "C": PLANT.C, "initial_state": (1.0, 0.0)}


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize(
    ("plant", "kind"),
    [
        (LinearPlant(**SAID), "none"), (LoadedPlant(**SAID), "constant"), (Swelling(**SAID), "moves"),
        (LinearPlant(**SAID, process_noise=(0.1, 0.0)), "noise"), (LinearPlant(**SAID, measurement_noise=(0.1,)), "noise"),
    ],
)  # fmt: skip
def test_the_kind_of_a_motion_without_inputs_is_found(plant: LinearPlant, kind: str, hidden: bool) -> None:
    """Where the states are not shown, a first state and a constant force explain what they can of the outputs."""
    tracks = [drive(plant, PERIOD_NS, np.zeros((60, 2)), seed) for seed in (1, 2)]
    tracks = [structs.replace(track, states=track.states[:, :1]) if hidden else track for track in tracks]
    names = ([(s.name, s.unit) for s in plant.states], [(s.name, s.unit) for s in plant.outputs])
    found = free_motion(MODEL, UNDELAYED, np.zeros((0, 2)), *tracks, names)
    assert found.kind == ("none" if hidden and kind == "constant" else kind)
    if hidden:
        assert free_motion(MODEL, np.zeros((1, 2, 2)), np.zeros((0, 2)), *tracks, names).kind == "not compared"


@pytest.mark.parametrize("states", [2, 1])
def test_a_record_fulfils_one_step_of_its_model_with_its_states_and_without(states: int) -> None:
    class Shows(LinearPlant):
        pass

    plant, u = Shows(**SAID), random_inputs(30, 2)
    track = drive(plant, PERIOD_NS, u)
    object.__setattr__(plant, "states", plant.states[:states])
    step = one_step(plant, MODEL)
    assert step is not None and [name for name, _ in step.names] == (["x1", "x2", "y1"] if states == 2 else ["y1"])
    record = np.hstack([track.states[:, :states], track.outputs, np.vstack([u, np.zeros(2)])])
    lags = len(step.taps)
    left = [sum(step.taps[i] @ record[k - i] for i in range(lags)) for k in range(lags - 1, len(record))]
    assert np.abs(left).max() < 1e-12
    large = structs.replace(MODEL, A=np.eye(LARGEST_POLYNOMIAL + 1), B=np.ones((LARGEST_POLYNOMIAL + 1, 2)))
    assert one_step(plant, large) is None and one_step(SwitchedExample(), MODEL) is None
    assert one_step(replace(PLANT, saturation=(1.0, 1.0)), MODEL) is None
