"""What is passive at the device: the wall's certificate holds with it, and it turns with what is not."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from design.controllers.rendered_wall import Coupler, wave_coupler
from design.controllers.wall import Material, Wall
from design.passivity.certificate import cut_off
from hil.api.experiment_source import load_experiment as experiment_of
from hil.compose import compose
from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from plants import LinearRun, Signal, StateSpace
from plants.parts.protocols import PassiveElement

WAVE = 'controller.coupler={method="wave"}'
RISING = "controller.coupler={method=\"taps\",taps_m_per_n=[0.2,0.02,0.03]}"


def verdict(*sets, name="omni-push"):
    return compose(load_experiment(name, [*sets, "allow_uncertified=true"])).verdict


@pytest.mark.parametrize("element", ["plant.coulomb_n=0.1", "plant.zones=[{from_m=0.02,damping=3.0}]"])
def test_what_only_takes_energy_leaves_the_wall_certified(element):
    found = verdict(element)
    assert found.certified and found.limit == pytest.approx(1.9857)
    assert any("only takes energy, as the plant says" in text for text in found.assumptions)


def test_the_worst_damping_of_the_workspace_decides():
    """The coupler made for b = 1.9857 does not hold where b falls to 1.9."""
    least = "plant.zones=[{from_m=0.02,damping=1.9}]"
    assert verdict(least, "controller.coupler.damping_n_s_per_m=1.9857").state == "undecided"
    made = verdict(least)
    assert made.certified and made.limit == pytest.approx(1.9)


def test_a_motor_that_saturates_is_taken_where_the_wall_asks_no_more_or_the_taps_never_rise():
    limit = "plant.force_limit_n=0.5"
    bare = verdict(limit)
    assert bare.state == "undecided" and "wall.force_limit_n = 0.5 keeps the wall within it" in bare.reason
    assert verdict(limit, "controller.wall.force_limit_n=0.5").certified
    assert verdict(limit, WAVE).certified
    assert verdict(limit, RISING).state == "undecided"


def test_an_encoder_that_rounds_stays_undecided():
    found = verdict("plant.encoder_step_m=1e-5", "plant.coulomb_n=0.1")
    assert found.state == "undecided" and found.reason.endswith("not decided with an encoder that rounds")


def test_a_refusal_is_on_the_model_alone():
    found = verdict("plant.coulomb_n=0.1", name="omni-theorem61")
    assert found.state == "undecided" and found.reason.startswith("refused for the plant's model")


@pytest.mark.parametrize("sets", [
    ["plant.coulomb_n=0.1"], ["plant.zones=[{from_m=0.02,damping=3.0}]"], ["plant.zones=[{from_m=0.02,damping=1.0}]"],
    ["plant.force_limit_n=0.5", WAVE], ["plant.force_limit_n=0.5", "controller.wall.force_limit_n=0.5"],
])  # fmt: skip
def test_the_motor_gives_nothing_beyond_what_damping_takes(sets):
    experiment = load_experiment("omni-push", [*sets, "duration=20"])
    assert simulate(compose(experiment), 0).arrays["/plant/state"]["given"].max() < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_a_force_that_is_cut_off_behind_falling_taps_takes_what_is_asked(seed):
    """sum sat(f) (C f - C f(k-1)) >= sum sat(f) (1 - z^-N) sat(f) T/(2 b): the inequality that `cut_off` rests on."""
    rng = np.random.default_rng(seed)
    period, damping, delay, most = 0.001, 7.0, int(rng.integers(0, 6)), 1.0
    taps = np.array(wave_coupler(period, damping, delay).taps_m_per_n)
    force = np.concatenate([np.abs(rng.standard_normal(400)) * rng.choice([0.5, 3.0], 400), np.zeros(delay + 2)])
    moved = np.diff(np.convolve(force, taps), prepend=0.0)[: force.size]
    left = np.minimum(force, most)
    asked = left - np.concatenate([np.zeros(delay + 1), left[: -delay - 1]])
    assert left @ moved >= period / (2 * damping) * (left @ asked) - 1e-12


def test_what_is_behind_a_motor_that_saturates_and_not_covered_is_named():
    springs = tuple(Material(stiffness_n_per_m=k) for k in (1000.0, 800.0))
    two = Wall(materials=springs, chain=((0.5, 0.5), (0.5, 0.5)))
    coupler = wave_coupler(0.001, 7.0, 2)
    assert "one stiffness behind taps that never rise" in cut_off(two, coupler, 5.0)
    assert not cut_off(Wall(material=1), coupler, 5.0)
    assert cut_off(Wall(material=1), Coupler(taps_m_per_n=(0.1, 0.05, 0.06)), 5.0)


def test_a_device_that_begins_behind_the_surface_gets_back_what_is_stored_there_and_no_more():
    changes = {"plant.initial_angle_rad": 0.1, "plant.hand.push.force_n": 0.0}
    experiment = experiment_of("omni-push", duration=5.0, **changes)
    loop = compose(experiment)
    assert loop.verdict is not None and loop.verdict.certified
    (said,) = [text for text in loop.verdict.assumptions if "begins 0.1 m behind the surface" in text]
    most = float(said.partition("up to ")[2].split()[0])
    assert most == pytest.approx(1.9857 * 0.1**2 / 0.05, rel=1e-3)
    given = simulate(loop, 0).arrays["/plant/state"]["given"].max()
    assert 0.01 < given <= most
    damped = experiment_of("omni-push", **changes, **{"limits.passivity": {"damping_n_s_per_m": 30.0}}, allow_uncertified=True)
    found = compose(damped).verdict
    assert found is not None and found.state == "undecided" and "behind the surface" in found.reason


@dataclass(frozen=True, kw_only=True)
class Bearing:
    """A device of one's own, whose model has the damping of the Omni, with something that only takes energy, as it says."""

    damping: float
    pushed: bool = False
    inputs: ClassVar = (Signal("force", "N"),)
    outputs: ClassVar = (Signal("position", "m"), Signal("y", "m"), Signal("z", "m"))
    states: ClassVar = (Signal("position", "m"), Signal("speed", "m/s"))
    tracked: ClassVar = ("position",)

    def model(self):
        return self._with(1.9857)

    def _with(self, damping):
        measured = [[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]]
        return StateSpace(A=[[0.0, 1.0], [0.0, -damping / 0.7943]], B=[[0.0], [1.0 / 0.7943]], C=measured)

    def beyond_model(self):
        return ("a bearing",)

    def passive_elements(self):
        return (PassiveElement("a bearing"),)

    def own_inputs(self):
        return ("a hand",) if self.pushed else ()

    def start(self, rng):
        return LinearRun(self._with(self.damping), (0.0, 0.5))


def test_a_device_of_ones_own_that_gives_energy_is_refused():
    def judged(device, **limits):
        changes = {"controller.coupler.damping_n_s_per_m": 1.9857, "allow_uncertified": True}
        return compose(experiment_of("omni-push", plant=device, **changes | (limits or {"limits.state": {}}))).verdict

    devices = Bearing(damping=2.5), Bearing(damping=1.7), Bearing(damping=2.5, pushed=True)
    honest, lying, pushed = map(judged, devices)
    assert honest.certified and any("takes what its damping takes" in text for text in honest.assumptions)
    assert lying.state == "refused" and "does not take energy as it says" in lying.reason
    assert pushed.certified and any("is not compared, for it has a hand" in text for text in pushed.assumptions)
    free = judged(devices[0], limits={})
    assert free.certified and any("random forces up to 1 N" in text for text in free.assumptions)


def test_the_damping_of_a_device_that_swings_faster_than_half_the_rate_is_not_read_from_its_samples():
    """The principal logarithm of its samples has another frequency and a negative damping; given taps need none."""
    fast = ["plant.inertia=0.02", "plant.hand.stiffness_n_per_m=900.0"]  # 212 rad/s at 20 Hz
    with pytest.raises(ExperimentError, match=r"swings faster than half the rate of samples of 0\.05 s"):
        verdict(*fast)
    found = verdict(*fast, "controller.coupler={method='taps', taps_m_per_n=[0.5]}")
    assert found.kind == "passivity" and found.details["damping_n_s_per_m"] == pytest.approx(1.9857)


def test_ends_that_equalise_are_judged_at_the_delay_that_they_wait_for():
    """With rows and gains for an age of 3 they wait for 3 slots, though the law has none above 2: taps for four fail at five."""
    short = [f"network.{way}.law={{kind='markov',ages=[1,2],matrix=[[0.9,0.1],[0.9,0.1]]}}" for way in ("sc", "ca")]
    four = compose(load_experiment("omni-wifi", short)).controller.coupler
    taps = f"controller.coupler={{method='taps',taps_m_per_n={list(four.taps_m_per_n)},equalise=true}}"
    assert verdict(*short, taps, name="omni-wifi").certified
    late = verdict(*short, taps, "network.sc.max_age=3", name="omni-wifi")
    assert late.state == "refused" and "at a delay of 5 samples" in late.reason
    made = verdict(*short, "network.sc.max_age=3", name="omni-wifi")
    assert made.certified and "at 5 samples of delay" in made.reason


def test_ends_that_have_too_few_samples_to_equalise_are_not_certified():
    made = compose(load_experiment("omni-wifi")).controller
    assert made.samples == 5
    for samples, state in ((5, "certified"), (4, "undecided")):
        own = replace(made, samples=samples)
        found = compose(experiment_of("omni-wifi", controller=own, allow_uncertified=True)).verdict
        assert found.state == state, found.reason
    assert "takes 5 samples a packet; it has 4" in found.reason


def test_ends_that_equalise_and_do_not_wait_for_what_comes_later_are_not_certified():
    """Packets are up to 4 slots old, and the wall waits for 2 or for 4."""
    late = "network.sc.law={kind='packet',latency={table=[[0,'15 ms'],[1,'40 ms']]}}"
    back = "network.ca={max_age=2,law={kind='constant',age=2}}"
    found = verdict(late, back, "network.sc.max_age=2", name="omni-wifi")
    assert found.state == "undecided" and "samples come up to 4 slots old, and the wall waits for 2" in found.reason
    assert verdict(late, back, "network.sc.max_age=4", name="omni-wifi").certified


def test_a_material_that_is_never_met_decides_nothing_of_model_following():
    """Row 0 alone runs where one material is touched; pulling on another one, it pulls nobody."""
    asked = experiment_of("omni-push", controller={"kind": "model-following"}, allow_uncertified=True)
    loop = compose(asked)
    own = loop.controller
    assert own.wall.met == (own.wall.material,) == (0,)
    pulls = tuple(row if i == 0 else tuple(-30.0 * each for each in row) for i, row in enumerate(own.feedback))
    found = compose(experiment_of("omni-push", controller=replace(own, feedback=pulls), allow_uncertified=True)).verdict
    assert found.details["spectral_radius"] == loop.verdict.details["spectral_radius"]


def test_a_coupler_is_made_for_the_delays_that_its_node_s_clock_and_medium_leave():
    """It was made for the largest age that has a row, and was not stable at the age that comes."""
    tip = {"outputs": ["position", "y", "z"]}
    turns = {"network.media": {"bus": {"kind": "round-robin", "nodes": ["tip"]}}}
    for clock, more, coupler, delays in (
        ({}, turns, {}, [6]), ({}, turns, {"varying": True}, [6]), ({"every": 3}, {}, {"varying": True}, [6, 7, 8]),
    ):  # fmt: skip
        nodes = {"network.nodes": {"tip": {**tip, "clock": clock}}, "network.sc.max_age": 8}
        loop = compose(experiment_of("omni-push", **nodes, **more, **{"controller.coupler": coupler}))
        assert loop.verdict.certified and loop.verdict.details["delays"] == delays
        assert loop.verdict.number == pytest.approx(1.9857, rel=1e-5)
        assert simulate(loop, 0).arrays["/plant/state"]["given"].max() < 1e-9


def test_model_following_is_made_for_the_delay_that_its_loop_has():
    """With rows for an age that its laws never draw it was made for that age, and unstable for its own hand."""
    asked = {"controller": {"kind": "model-following"}, "allow_uncertified": True, "limits": {"watchdog_slots": 10}}
    plain, rows = (compose(experiment_of("omni-push", **asked, **more)) for more in ({}, {"network.sc.max_age": 5}))
    assert rows.controller == plain.controller
    assert rows.verdict.details["spectral_radius"] == plain.verdict.details["spectral_radius"] < 1.0
    assert simulate(rows, 0).arrays["/plant/state"]["position"][-1] == pytest.approx(1e-3, rel=1e-3)
    with pytest.raises(ExperimentError, match=r"feedback: made for other delays or materials, expected 2 \+ 3 at most"):
        compose(experiment_of("omni-push", controller=plain.controller, allow_uncertified=True, **{"network.sc.law.age": 2}))
