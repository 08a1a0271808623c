"""A wall is certified over a passive device that measures the position its force acts on; over any other it is undecided."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.rig import port_of
from hil.runtime.virtual import simulate
from plants import LinearRun, Signal, StateSpace
from plants.state_space import LinearPlant

PUSH = {"limits": {"watchdog_slots": 10}, "disturbance": [{"at": 1.0, "value": [2.0], "samples": 400}], "duration": 10.0}


def device(A=((0.0, 1.0), (0.0, -2.5)), B=((0.0,), (1.25,)), position=(1.0, 0.0), unit="m", force="N", **more):
    outputs = (Signal("position", unit), Signal("y", "m"), Signal("z", "m"))
    return LinearPlant(A=A, B=B, C=(position, (0.0, 0.0), (0.0, 0.0)), inputs=(Signal("force", force),), outputs=outputs, **more)


def judged(plant, **more):
    changes = {**PUSH, **more, "controller.coupler.damping_n_s_per_m": 1.9857, "allow_uncertified": True}
    loop = compose(load_experiment("omni-push", plant=plant, **changes))
    return loop, loop.verdict


def given(loop):
    """The largest energy in J that the motor gave beyond what 2 N s/m took, from the log."""
    arrays = simulate(loop, 0).arrays
    moved, force = np.diff(arrays["/plant/state"]["x1"]), arrays["/actuator/applied"]["force"][:-1]
    return float(np.cumsum(force * moved - 2.0 * moved**2 / loop.model.period_s).max())


def test_a_device_that_measures_its_position_is_certified_and_is_given_nothing():
    for plant in (device(), device(unit="rad", force="N m"), device(process_noise=(0.0, 0.1), noise_step_s=0.01)):
        loop, verdict = judged(plant)
        assert verdict.certified, verdict.reason
        assert given(loop) < 1e-9


def test_a_motor_of_matrices_that_saturates_is_taken_where_the_wall_asks_no_more():
    """As the motor of the Omni is; the wall's force is cut off at the limit in either, and no energy is given by that."""
    loop, verdict = judged(device(saturation=(0.5,)), **{"controller.wall.force_limit_n": 0.5})
    assert verdict.certified and "saturated actuators: cuts the force off, as the plant says" in verdict.assumptions
    assert given(loop) < 1e-9
    bare = judged(device(saturation=(0.5,)))[1]
    assert bare.state == "undecided" and "wall.force_limit_n = 0.5 keeps the wall within it" in bare.reason


@pytest.mark.parametrize("other", [
    {"position": (3.0, 0.0)}, {"position": (1000.0, 0.0), "unit": "mm"}, {"position": (0.0, 1.0), "unit": "m/s"}, {"unit": "rad"},
    {"A": ((0.0, 1.0), (50.0, -2.5))}, {"A": ((0.0, 1.0), (0.0, 0.1))}, {"B": ((0.3,), (1.25,))}, {"B": ((0.0,), (-1.25,))},
])  # fmt: skip
def test_a_device_that_is_not_passive_or_measures_something_else_is_undecided(other):
    """What it measures times three gives 2.5 J to the hand, in millimetres kilojoules; springs and dampers may give, too."""
    plant = device(**other)
    loop, verdict = judged(plant)
    assert (verdict.kind, verdict.state) == ("passivity", "undecided")
    assert verdict.reason.startswith("a wall is certified over a passive device")
    if "position" in other:
        assert given(loop) > 0.01
    elif "unit" not in other:
        assert port_of(plant) is None


def test_noise_in_the_measured_position_gives_energy_and_leaves_the_wall_undecided():
    loop, verdict = judged(device(measurement_noise=(0.01, 0.0, 0.0)))
    assert verdict.state == "undecided" and "m is in the measured position, which gives energy" in verdict.reason
    assert given(loop) > 1e-4
    assert judged(device(measurement_noise=(0.0, 0.01, 0.0)))[1].certified  # it only picks the material


@dataclass(frozen=True, kw_only=True)
class Own:
    """A device of one's own: it moves by another damping than its model has, trembles in what it measures, or logs more."""

    damping: float = 2.0
    trembles_m: float = 0.0
    begins_m: float = 0.0
    states: tuple[Signal, ...] = (Signal("position", "m"), Signal("speed", "m/s"))
    inputs: ClassVar = (Signal("force", "N"),)
    outputs: ClassVar = (Signal("position", "m"), Signal("y", "m"), Signal("z", "m"))
    tracked: ClassVar = ("position",)

    def model(self):
        return device().model()

    def motion(self):
        return StateSpace(A=[[0.0, 1.0], [0.0, -1.25 * self.damping]], B=[[0.0], [1.25]], C=self.model().C)

    def start(self, rng):
        return OwnRun(self, rng)


class OwnRun(LinearRun):
    def __init__(self, own, rng):
        super().__init__(own.motion(), (own.begins_m * float(rng.random()), 0.0))
        self.own, self.rng, self.error = own, rng, 0.0

    def advance(self, dt_ns, u, w=()):
        super().advance(dt_ns, u, w)
        self.error = self.own.trembles_m * float(self.rng.standard_normal())

    def measure(self):
        position, *others = super().measure()
        return (position + self.error, *others)

    @property
    def state(self):
        x = super().state
        return (*x, x[1] ** 2)[: len(self.own.states)]


def test_the_damping_by_which_a_device_moves_is_counted_and_not_that_of_its_model():
    assert judged(Own())[1].certified
    loop, verdict = judged(Own(damping=0.2))
    assert loop.rig.port.damping == pytest.approx(0.2) and verdict.state == "refused"


def test_noise_that_a_device_does_not_state_is_found():
    for states in (Own().states, (*Own().states, Signal("energy", "J"))):
        found = judged(Own(trembles_m=1e-4, states=states))[1]
        assert found.state == "undecided" and "in the measured position" in found.reason
        assert judged(Own(states=states))[1].certified


def test_what_is_stored_where_a_device_begins_by_chance_is_said_for_any_place():
    """A number for one seed is none for another: 2 N s/m over 50 ms are 40 J/m^2."""
    (said,) = [text for text in judged(Own(begins_m=0.1))[1].assumptions if "behind the surface" in text]
    assert "begins by chance" in said and "up to 40 J/m^2 times x^2" in said
