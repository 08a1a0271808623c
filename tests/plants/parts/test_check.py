"""Every plant of ours keeps to the contract, and the check notices one that does not."""

import dataclasses
import hashlib
import math
import struct
import subprocess
import sys
from dataclasses import replace

import msgspec
import numpy as np
import pytest

import plants
from plants import DCMotor, DelayedStates, DelayedVTOL, FaultyVTOL, Omni, PlantError, SwitchedExample, check_plant
from plants.parts import Signal
from plants.parts.linear_run import LinearRun

OURS = {
    "dc-motor": DCMotor(),
    "dc-motor-experimental": DCMotor.experimental(),
    "vtol": plants.VTOL(),
    "omni": Omni(),
    "smjls": SwitchedExample(),
    "smjls-sampled": SwitchedExample(uncertainty="sampled"),
    "vtol-delayed": DelayedVTOL(),
    "vtol-fault": FaultyVTOL(),
    "delayed-states": DelayedStates(),
}


@pytest.mark.parametrize("name", OURS)
def test_our_plants_keep_to_the_contract(name):
    check_plant(OURS[name])


@pytest.mark.parametrize("name", OURS)
def test_parameters_survive_the_way_through_plain_values(name):
    """What an experiment writes down as its resolved form gives the same plant again."""
    plant = OURS[name]
    assert msgspec.convert(msgspec.json.decode(msgspec.json.encode(plant)), type(plant)) == plant


@pytest.mark.parametrize("name", OURS)
def test_every_parameter_is_documented(name):
    plant = type(OURS[name])
    for field in dataclasses.fields(plant):
        assert field.name in plant.__doc__.split("Args:")[1], field.name


class Integrator:
    """A plant that keeps to the contract, to be broken in one rule each."""

    inputs = outputs = states = (Signal("x", "1"),)

    def model(self):
        return plants.StateSpace(A=[[0.0]], B=[[1.0]], C=[[1.0]])

    def start(self, rng):
        return LinearRun(self.model(), (rng.normal(),))


def test_a_plant_that_is_not_ours_can_be_checked():
    check_plant(Integrator(), tolerance=1e-15)


class Unseeded(Integrator):
    def start(self, rng):
        return LinearRun(self.model(), (np.random.default_rng().normal(),))


class Deaf:
    def __init__(self, run):
        self.run = run

    def __getattr__(self, name):
        return getattr(self.run, name)

    def advance(self, dt_ns, u, w=()):
        self.run.advance(dt_ns, u)


class Undisturbed(Integrator):
    def start(self, rng):
        return Deaf(LinearRun(self.model(), (0.0,)))


class Twins(Integrator):
    states = (Signal("x", "1"), Signal("x", "1"))


class Spaced(Integrator):
    states = (Signal("the x", "1"),)


class Numbered(Integrator):
    inputs = (Signal("u", 3),)


class Longer(Integrator):
    def start(self, rng):
        return LinearRun(self.model(), (0.0, 0.0))


class Wide(Integrator):
    inputs = (Signal("a", "V"), Signal("b", "V"))


class Delayed(Integrator):
    def state_delays(self):
        return np.zeros((2, 1, 2))


class Elsewhere(Integrator):
    def motion(self):
        return self.model().A


class Vague(Integrator):
    def departures(self):
        return ("wind",)


class Costly(Integrator):
    def cost_weights(self):
        return np.array([[-1.0]]), np.eye(1)


def jumps(**changed):
    class Jumps(DelayedVTOL):
        def jump_system(self):
            return replace(DelayedVTOL.jump_system(self), **changed)

    return Jumps()


def test_what_a_plant_with_delayed_states_and_a_cost_earns_is_said():
    said = check_plant(DelayedStates())
    assert any("is HasStateDelays" in line and "its 5 delayed states" in line for line in said)
    assert any("is HasCost" in line for line in said)
    assert not any("HasCost" in line or "HasStateDelays" in line for line in check_plant(DCMotor()))


@pytest.mark.parametrize(
    ("plant", "message"),
    [
        (Delayed(), r"Delayed.state_delays\(\): shape \(2, 1, 2\), expected \(tau, 1, 1\)"),
        (Elsewhere(), r"Elsewhere.motion\(\): array\(\[\[0.\]\]\), expected a StateSpace with the states"),
        (Vague(), r"Vague.departures\(\): \('wind',\), expected a tuple of plants.Departure"),
        (Costly(), r"Costly.cost_weights\(\): Xi has the eigenvalue -1"),
        (Unseeded(), "Unseeded.start: same seed, another state"),
        (Undisturbed(), r"Undisturbed.advance: w moves the state by .* otherwise than u \(slot 0\); hold u \+ w"),
        (Twins(), "Twins.states: a name comes twice"),
        (Spaced(), r"Spaced.states: Signal\(name='the x', unit='1'\), expected a name of letters, digits and _, and a unit"),
        (Numbered(), r"Numbered.inputs: Signal\(name='u', unit=3\), expected a name"),
        (Longer(), "initial_state: 2 numbers, expected 1, one for each state"),
        (Wide(), "Wide.model: 1 inputs, expected 2"),
        (jumps(delay_slopes=(0.1,)), "Jumps.jump_system: 1 delay_slopes, expected 3"),
        (jumps(min_delay_s=1.0), r"Jumps.jump_system: min_delay_s 1, expected 0 to max_delay_s \(0.3\)"),
        (jumps(E=(((0.0,),) * 4,) * 2), "Jumps.jump_system: E of 2 modes"),
        (jumps(C=(((1.0,),),) * 3), r"Jumps.jump_system: C of shape \(1, 1\); the plant measures 4 states and the mode"),
        (jumps(E=(((math.nan,),) * 4,) * 3), "Jumps.jump_system: E is not finite"),
    ],
)
def test_a_plant_that_breaks_a_rule_is_named(plant, message):
    with pytest.raises(PlantError, match=message):
        check_plant(plant)


def test_plants_load_nothing_that_is_slow():
    """A rig imports its plant: no scipy, no control, no matplotlib may come with it."""
    use = "[getattr(plants, name) for name in plants.__all__]; plants.VTOL().model().discretise(0.01)"
    code = f"import sys, plants; {use}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"scipy", "control", "cvxpy", "matplotlib"} & set(loaded)
    assert "plants.dc_motor" in loaded


@pytest.mark.parametrize(
    ("plant", "digest"),
    [
        (DCMotor(), "7a738910c6601d2a"),
        (DCMotor.experimental(), "df6e640da947bdcb"),
        (plants.VTOL(initial_state=(1.0, 0.5, -0.2, 0.3)), "72550cfe4a70cc38"),
    ],
)
def test_states_are_the_same_bits_on_every_machine(plant, digest):
    """The digests were taken on one machine; integers and IEEE operations leave no other outcome."""
    run, h = plant.start(np.random.default_rng(0)), hashlib.sha256()
    for k in range(400):
        run.advance(10_000_000, (0.01 * ((k * 7919) % 13 - 6),) * len(plant.inputs))
        h.update(struct.pack(f"<{len(run.state)}d", *run.state))
    assert h.hexdigest()[:16] == digest


class Euler(Integrator):
    def model(self):
        return plants.StateSpace(A=[[-1.0]], B=[[1.0]], C=[[1.0]])

    def start(self, rng):
        return EulerRun()


class EulerRun:
    """x' = -x + u in one explicit step, however long it is."""

    def __init__(self):
        self.state, self.applied = (0.0,), (0.0,)

    def advance(self, dt_ns, u, w=()):
        self.applied = tuple(u)
        self.state = (self.state[0] + dt_ns * 1e-9 * (u[0] + sum(w) - self.state[0]),)

    def measure(self):
        return self.state


def test_a_plant_that_takes_a_slot_in_one_crude_step_learns_how_to_integrate():
    with pytest.raises(PlantError, match=r"a slot in one step and in two ends in states that differ by .* \(slot .*Runge-Kutta"):
        check_plant(Euler())
