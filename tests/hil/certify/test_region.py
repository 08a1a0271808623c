"""Motors whose supply saturates: where the region ends, beside runs from its edge and from beyond it.

By moments of few terms, which give a smaller region of the same kind; what the shipped motors have stands in
`test_shipped_regions.py`.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

from design.jump_linear import leaving as moments
from design.jump_linear.leaving import SLOTS
from design.verdict import Verdict
from hil.api.experiment_source import load_experiment
from hil.certify.region import RISK
from hil.compose import compose
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from plants import DCMotor, Departure, Driver, LinearPlant
from tests.hil.certify.many_runs import many_runs

pytestmark = pytest.mark.usefixtures("moments_of_low_degree")

SUPPLY = 0.058
ENCODER: dict[str, Any] = {"plant.encoder": {"step_rad": 0.0038}}
DYNAMIC: dict[str, Any] = {"controller": {"kind": "output-feedback", "A": [[0.5]], "B": [[0.1]], "C": [[-0.01]], "D": [[-0.05]]}}
TWO_SAMPLES: dict[str, Any] = {
    "controller": {"kind": "send-all", "selection": "constant", "samples": 2, "gains": [[[[-0.15, 0.1]]]] * 3},
}

ANYWHERE = "practical stability"
"""The kind of a verdict on a loop that ends within a bound however long its commands saturate."""


def composed(name: str = "dc-motor-h2", **changes: Any) -> Loop:
    calm = {"reference": [], "disturbance": [], "duration": 2, "allow_uncertified": True}
    return _composed(name, json.dumps(calm | {"plant.driver": {"saturation_v": SUPPLY}} | changes), moments.MOST_PRODUCTS)


@cache
def _composed(name: str, changes: str, products: int) -> Loop:
    return compose(load_experiment(name, **json.loads(changes)))


def verdict_of(loop: Loop) -> Verdict:
    assert loop.verdict is not None
    return loop.verdict


def edge_of(loop: Loop) -> dict[str, float]:
    region: Any = verdict_of(loop).details["region"]
    assert region["within"][0]["probability"] == RISK
    found: dict[str, float] = region["within"][0]["states"]
    return found


def leaving_share(loop: Loop, runs: int) -> float:
    return float((np.abs(many_runs(loop, runs)[1]).max(axis=0) > SUPPLY).mean())


@pytest.mark.parametrize(("changes", "state"), [({}, "angle"), ({}, "speed"), (ENCODER, "angle"), (DYNAMIC, "angle")])
def test_runs_from_the_edge_stay_and_from_four_times_as_far_they_leave(
    changes: dict[str, Any], state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """30 runs: 4 that leave at 0.01 have probability 2e-4, and with 0.3, 0.99; from 4 times as far most of 12 leave."""
    sharp = 1_300_000 if changes is DYNAMIC else 500_000  # one state more: moments of the same degree are more
    monkeypatch.setattr(moments, "MOST_PRODUCTS", sharp)
    start = f"plant.initial_{state}_" + {"angle": "rad", "speed": "rad_s"}[state]
    edge = edge_of(composed(**changes))[state]
    assert edge > 0.0
    inside = composed(**changes | {start: 0.999 * edge})
    verdict = verdict_of(inside)
    assert verdict.certified and verdict.kind == "stability in a region" and verdict.limit == RISK
    assert verdict.number is not None and 0.001 < verdict.number <= RISK
    assert leaving_share(inside, 30) < 0.13
    outside = verdict_of(composed(**changes | {start: 1.2 * edge}))
    assert outside.kind != "stability in a region" or outside.state == "undecided"
    assert "not decided from where this run begins" in outside.reason
    assert leaving_share(composed(**changes | {start: 4.0 * edge}), 12) > 0.5


def test_steps_of_the_reference_and_disturbances_count_and_a_load_is_not_judged() -> None:
    edge = edge_of(composed())["angle"]
    assert verdict_of(composed(reference=[{"at": "1 s", "value": [0.99 * edge]}])).certified
    there_and_back = [{"at": "1 s", "value": [0.8 * edge]}, {"at": "1.1 s", "value": [-0.8 * edge]}]
    assert verdict_of(composed(reference=there_and_back)).kind == ANYWHERE
    pushed = [verdict_of(composed(disturbance=[{"at": "1 s", "samples": 2, "value": [w]}])) for w in (0.002, 1.0)]
    assert pushed[0].certified and pushed[0].number is not None and pushed[0].number > 0.0 and pushed[1].kind == ANYWHERE
    assert verdict_of(composed(disturbance=[{"at": "100 s", "samples": 2, "value": [0.001]}])).kind == ANYWHERE
    two = verdict_of(composed(**TWO_SAMPLES | {"plant.initial_angle_rad": 0.01}))
    assert two.state == "undecided" and "its first packets repeat their sample" in two.reason
    assert verdict_of(composed(**TWO_SAMPLES | {"reference": [{"at": "1 s", "value": [0.05]}]})).certified
    loaded = verdict_of(composed(**{"plant.load": {"torque_v": 0.001}}))
    assert loaded.state == "undecided" and "a load torque" in loaded.reason and "region" not in loaded.details


def test_a_disturbance_is_judged_as_far_as_slots_are_looked_at() -> None:
    for first, samples, judged in ((SLOTS - 2, 1, True), (SLOTS - 1, 1, False), (SLOTS - 3, 2, True), (SLOTS - 2, 2, False)):
        pulse = [{"at": 0.05 * first, "samples": samples, "value": [0.001]}]
        assert (verdict_of(composed(disturbance=pulse)).kind != ANYWHERE) is judged, (first, samples)


def test_an_edge_scales_with_the_supply_and_departures_make_it_smaller() -> None:
    one, two = (edge_of(composed(**{"plant.driver": {"saturation_v": s}})) for s in (SUPPLY, 2.0 * SUPPLY))
    assert two["angle"] == pytest.approx(2.0 * one["angle"], rel=1e-6)
    counts = {"plant.driver": {"saturation_v": SUPPLY, "pwm_step_v": 0.0005}}
    assert edge_of(composed(**counts))["angle"] < 0.95 * one["angle"]


def test_for_the_realistic_motor_the_verdict_says_how_much_supply_its_friction_asks_for() -> None:
    shipped = verdict_of(compose(load_experiment("dc-motor-h2-friction")))
    region: Any = shipped.details["region"]
    assert shipped.kind == ANYWHERE and set(region["within"][0]["states"].values()) == {0.0}
    assert 0.4 < region["pushed_share"][0] < 0.5 and f"{region['limits_times']:.3g} times as large" in shipped.reason
    enough = {"plant.driver.saturation_v": 1.05 * SUPPLY * region["limits_times"], "reference": [], "disturbance": []}
    larger = verdict_of(compose(load_experiment("dc-motor-h2-friction", **enough)))
    assert larger.kind == "stability in a region" and larger.certified and "ends, in the root mean square" in larger.reason


def composed_as_shipped(**changes: Any) -> Loop:
    return _composed("dc-motor-hinf-supply", json.dumps({"allow_uncertified": True} | changes), moments.MOST_PRODUCTS)


@pytest.mark.parametrize(
    ("state", "runs", "leaving"),
    [("angle", 40, 5), ("speed", 40, 5), pytest.param("angle", 3000, 60, marks=pytest.mark.slow)],
)
def test_realistic_runs_from_the_edge_stay_and_end_within_the_bound_and_from_four_times_as_far_they_leave(
    state: str, runs: int, leaving: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs of 4 s: that 5 of 40 leave has probability 5e-5 at 0.01 and 0.98 at 0.25, that 60 of 3000 do 8e-7."""
    monkeypatch.setattr(moments, "MOST_PRODUCTS", 500_000)
    supply, calm = 1.2, {"reference": [], "disturbance": [], "duration": 4}
    start = f"plant.initial_{state}_" + {"angle": "rad", "speed": "rad_s"}[state]
    edge = edge_of(composed_as_shipped(**calm))[state]
    inside = composed_as_shipped(**calm, **{start: 0.999 * edge})
    assert verdict_of(inside).certified
    states, asked = many_runs(inside, runs)
    bounds: Any = verdict_of(inside).details["ends_within"]
    assert (np.abs(asked).max(axis=0) > supply).sum() < leaving
    assert bounds["angle"] / 40.0 < np.sqrt(np.mean(states["angle"][-1] ** 2)) <= bounds["angle"]
    far = composed_as_shipped(**calm, **{start: 4.0 * edge, "limits.state": {}})
    assert (np.abs(many_runs(far, 12)[1]).max(axis=0) > supply).mean() > 0.5


def test_a_state_space_plant_with_limits_has_a_region_and_with_noise_none() -> None:
    matrices: Any = {"A": ((0.0, 1.0), (0.0, -3.5287)), "B": ((0.0,), (172.38,)), "C": ((1.0, 0.0),), "saturation": (SUPPLY,)}
    plain = edge_of(of_plant(LinearPlant(**matrices)))
    assert plain["x1"] == pytest.approx(edge_of(composed())["angle"], rel=1e-6)
    for noise in ({"measurement_noise": (0.001,)}, {"process_noise": (0.0, 0.001)}):
        noisy = verdict_of(of_plant(LinearPlant(**matrices, **noise)))
        assert noisy.state == "undecided" and "noise" in noisy.reason and "region" not in noisy.details


def of_plant(plant: LinearPlant | DCMotor) -> Loop:
    changes: Any = {"reference": [], "disturbance": [], "limits.state": {}, "allow_uncertified": True}
    return compose(load_experiment("dc-motor-h2", plant=plant, **changes))


class Boaster(DCMotor):
    """Says that it saturates at twice the command at which it does."""

    def departures(self) -> tuple[Departure, ...]:
        return tuple(each._replace(within=tuple(2.0 * limit for limit in each.within)) for each in DCMotor.departures(self))


def test_a_plant_that_leaves_its_limits_earlier_than_it_says_is_refused() -> None:
    verdict = of_plant(Boaster(driver=Driver(saturation_v=SUPPLY))).verdict
    assert verdict is not None and verdict.state == "refused" and "departures() says at most" in verdict.reason


@pytest.mark.parametrize("rule", ["previous", "generated", "both"])
def test_a_step_that_the_first_rows_answer_is_not_judged_by_later_ones(rule: str) -> None:
    """A packet has rows for delays up to 2, the law has delay 1: the first packets take the row for 2, 50 times the others."""
    rows = [[[-1.0 if i == {"both": 7}.get(rule, 2) else -0.02]] for i in range(9 if rule == "both" else 3)]
    ages = {name: {"max_age": most, "law": {"kind": "constant", "age": age}} for name, age, most in (("sc", 0, 0), ("ca", 1, 2))}
    changes = {"controller": {"kind": "send-all", "selection": rule, "gains": [rows]}, "network": ages}
    for at, within in ((0.0, False), (1.0, True)):
        loop = composed(reference=[{"at": at, "value": [0.5]}], **changes)
        assert (verdict_of(loop).kind == "stability in a region") == within
        commands = simulate(loop, 0, ["/actuator/applied"]).arrays["/actuator/applied"]["voltage"]
        assert bool(np.abs(commands).max() < SUPPLY) == within


@pytest.mark.parametrize("unit", [1.0, 1e-10])
def test_a_steady_command_is_one_in_any_unit_of_the_input(unit: float) -> None:
    plant = LinearPlant(A=((-1.0,),), B=((1.0 / unit,),), C=((1.0,),), saturation=(unit,))
    changes: Any = {"reference": [{"at": 0.5, "value": [0.5]}], "disturbance": [], "limits.state": {}, "allow_uncertified": True}
    changes["controller"] = {"kind": "local", "gain": [[-0.1 * unit]]}
    verdict = verdict_of(compose(load_experiment("dc-motor-h2", plant=plant, **changes)))
    assert verdict.state == "undecided" and "its reference needs a steady command" in verdict.reason


@pytest.mark.parametrize("instants", [(1.0, 1.0), (1.01, 0.99)])
def test_of_two_steps_in_one_slot_the_last_is_judged(instants: tuple[float, float]) -> None:
    gain = {"controller": {"kind": "local", "gain": [[-0.02]]}}
    for values in ((-5.0, 0.5), (0.5, -5.0)):
        steps = [{"at": at, "value": [value]} for at, value in zip(instants, values)]
        loop = composed(reference=steps, **gain)
        commands = simulate(loop, 0, ["/actuator/applied"]).arrays["/actuator/applied"]["voltage"]
        within = bool(np.abs(commands).max() < SUPPLY)
        assert (verdict_of(loop).kind == "stability in a region") == within == (values[1] == 0.5)


class Careful(DCMotor):
    """Does not say what becomes of a disturbance beyond its limits."""

    def departures(self) -> tuple[Departure, ...]:
        return tuple(each._replace(clips=False) for each in DCMotor.departures(self))


def test_a_disturbance_above_the_supply_acts_by_a_share_where_the_plant_says_so() -> None:
    """0.002 V of a supply of 0.0015 V would leave nothing for the command, in one pulse or two; runs bear the verdict out."""
    gains: Any = {"controller": {"kind": "local", "gain": [[-0.001]]}, "reference": [], "allow_uncertified": True}
    for through, pulses in ((True, 1), (False, 2)):
        pulse: Any = {"disturbance": [{"at": "1 s", "samples": 2, "value": [0.002 / pulses]}] * pulses, "duration": 10}
        pulse["limits.state"] = {}
        motors = [kind(driver=Driver(saturation_v=0.0015), disturbance_through_driver=through) for kind in (DCMotor, Careful)]
        loops = [compose(load_experiment("dc-motor-h2", plant=motor, **gains, **pulse)) for motor in motors]
        assert [verdict_of(loop).state for loop in loops] == ["certified", "undecided"]
        assert np.abs(many_runs(loops[0], 8)[1]).max() < 0.0015


def test_what_the_limits_of_one_input_clip_of_a_disturbance_no_other_input_takes_back() -> None:
    """Of (0.5, -0.5) the first input may pass 0.1 and the second all, as in a plant that clips: together they move nothing."""
    plant = LinearPlant(A=((0.0,),), B=((1.0, 1.0),), C=((1.0,),), saturation=(0.1, 1000.0))
    rest: Any = {f"network.{link}": {"law": {"kind": "constant", "age": 0}, "max_age": 0} for link in ("sc", "ca")}
    rest |= {"reference": [], "allow_uncertified": True, "limits": {}, "controller": {"kind": "local", "gain": [[-1.0], [-1.0]]}}
    for size, inside in ((0.01, True), (0.5, False)):
        pushed = [{"at": "1 s", "samples": 20, "value": [size, -size]}]
        verdict = verdict_of(compose(load_experiment("dc-motor-h2", plant=plant, disturbance=pushed, **rest)))
        region: Any = verdict.details["region"]
        assert (region["own_probability"] <= RISK) == verdict.certified == inside, verdict


class Boastful(DCMotor):
    """Has a disturbance act by 3 times of what it is, and says that its limits clip it."""

    def start(self, rng: np.random.Generator) -> Any:
        run = DCMotor.start(self, rng)

        class Run:
            def advance(self, dt_ns: int, u: Any, w: Any = ()) -> None:
                run.advance(dt_ns, u, [3.0 * each for each in w])

            def __getattr__(self, name: str) -> Any:
                return getattr(run, name)

        return Run()


def test_a_plant_whose_disturbance_acts_otherwise_than_it_says_is_refused() -> None:
    loop = of_plant(Boastful(driver=Driver(saturation_v=SUPPLY)))
    verdict = verdict_of(loop)
    assert verdict.state == "refused" and "departures() says at most" in verdict.reason


@pytest.mark.parametrize("changes", [{}, TWO_SAMPLES, DYNAMIC])
def test_the_start_of_a_loop_and_its_steps_are_those_of_its_emulator(
    changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over constant ages the command of every slot follows from where the certifier says that the loop begins."""
    import hil.certify.region as region

    kept: list[Any] = []

    def keep(loop: Any, verdict: Verdict, closed: Any, **rest: Any) -> Verdict:
        kept.append(closed)
        return verdict

    monkeypatch.setattr(region, "judge_region", keep)
    ages = {f"network.{link}.law": {"kind": "constant", "age": age} for link, age in (("sc", 2), ("ca", 1))}
    step = [{"at": "1 s", "value": [0.2]}]
    for moved, slot in (({"plant.initial_angle_rad": -0.2}, 0), ({"reference": step}, 20)):
        if changes is TWO_SAMPLES and slot == 0:
            continue  # its first packets repeat their sample
        loop = composed(**changes | ages | moved)
        closed = kept.pop()
        u = simulate(loop, 0, ["/actuator/applied"]).arrays["/actuator/applied"]["voltage"][slot : slot + 20]
        start = closed.standing if slot else np.eye(*closed.standing.shape)
        x, foretold = start @ [-0.2, 0.0], []
        for _ in u:
            foretold.append((closed.inputs[0] @ x).item())
            x = closed.matrices[0] @ x
        assert np.abs(u[6:]).min() > 0.0
        np.testing.assert_allclose(u, foretold, rtol=1e-5, atol=1e-9)  # a command travels as a float of 32 bits
