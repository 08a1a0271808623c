"""A motor that saturates ends where its verdict says, from anywhere; an unstable plant does not come back from too far."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from design.controllers import SendAll
from design.verdict import Verdict
from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.errors import ExperimentError
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from plants import DCMotor
from plants.dc_motor import Driver
from tests.hil.certify.many_runs import many_runs

pytestmark = pytest.mark.usefixtures("moments_of_low_degree")

NAME, LATEST = "dc-motor-h2-friction", {"kind": "constant"}
CALM: dict[str, Any] = {"reference": [], "disturbance": [], "limits.state": {}, "allow_uncertified": True}


def composed(**changes: Any) -> Loop:
    return compose(load_experiment(NAME, **CALM | changes))


def hinf(**changes: Any) -> Verdict:
    return verdict_of(compose(load_experiment("dc-motor-hinf-friction", **CALM | changes)))


def verdict_of(loop: Loop) -> Verdict:
    assert loop.verdict is not None
    return loop.verdict


def bounds_of(verdict: Verdict) -> dict[str, float]:
    found: Any = verdict.details["ends_surely_within"]
    return dict(found)


def test_the_shipped_motor_is_certified_and_its_own_run_ends_within() -> None:
    shipped = compose(load_experiment(NAME))
    verdict = verdict_of(shipped)
    assert verdict.certified and verdict.kind == "practical stability" and not shipped.experiment.allow_uncertified
    assert verdict.number is not None and 0.0 < verdict.number < 0.2
    assert "in every order of delays up to 3 slots" in verdict.reason
    state = simulate(shipped, 0, ["/plant/state"]).arrays["/plant/state"]
    late = state[(state["t_ns"] > 15e9) & (state["t_ns"] < 30e9)]
    bounds = bounds_of(verdict)
    assert np.abs(late["angle"] - 3.0).max() < bounds["angle"] and np.abs(late["speed"]).max() < bounds["speed"]


@pytest.mark.parametrize("latest", [False, True])
@pytest.mark.parametrize(
    "start", [{"plant.initial_angle_rad": 15.0}, {"plant.initial_angle_rad": -6.0, "plant.initial_speed_rad_s": 40.0}]
)
def test_runs_from_far_away_end_within(start: dict[str, Any], latest: bool) -> None:
    """In the order of delays that the law draws, and in the latest that it allows; from 15 rad commands saturate for 10 s."""
    loop = composed(duration=30, **start)
    bounds = bounds_of(verdict_of(loop))
    assert verdict_of(loop).certified
    late = {"network.sc.law": LATEST | {"age": 2}, "network.ca.law": LATEST | {"age": 1}} if latest else {}
    ran = composed(duration=30, **start, **late) if latest else loop
    state = simulate(ran, 3, ["/plant/state"]).arrays["/plant/state"]
    for name, bound in bounds.items():
        assert np.abs(state[name][400:]).max() < bound
    assert np.abs(state["angle"][:20]).max() > 2.0 * bounds["angle"]


def test_what_it_leans_on_turns_it() -> None:
    """A supply weaker than friction and dead zone together, and a load: undecided. A gain that leads away: in the mean alone."""
    gains = [[[[-0.198]], [[-0.1]]], [[[-0.1]], [[0.01]]], [[[-0.1]], [[-0.1]]]]
    table = {"kind": "send-all", "selection": "applied", "gains": gains}
    for change in ({"plant.driver.saturation_v": 0.0058}, {"plant.load": {"torque_v": 0.001}}):
        verdict = verdict_of(composed(**change))
        assert verdict.state == "undecided" and not {"ends_surely_within", "ends_from_anywhere_within"} & set(verdict.details)
    away = verdict_of(composed(controller=table))
    assert away.certified and "ends_surely_within" not in away.details and "in the root mean square" in away.reason
    gains[1][1] = [[-0.01]]
    assert "ends_surely_within" in verdict_of(composed(controller=table)).details


def test_a_controller_with_a_state_ends_within_where_all_that_it_remembers_leads_back() -> None:
    """Gains that know the measured delay lead away after some orders of it; from 15 rad commands saturate for 10 s."""
    asked = {"kind": "designed", "order": 2, "input_weight": 0.5, "reference_weight": 3.0}
    loop = composed(controller={**asked, "information": "constant"})
    bounds, controller = bounds_of(verdict_of(loop)), loop.controller
    assert isinstance(controller, SendAll) and verdict_of(loop).certified
    table = {"kind": "send-all", **{name: getattr(controller, name) for name in ("selection", "gains", "state_gains")}}
    late = {"network.sc.law": LATEST | {"age": 2}, "network.ca.law": LATEST | {"age": 1}}
    far = {"plant.initial_angle_rad": 15.0, "limits.input": [100.0], "duration": 30}
    for order in ({}, late):
        state = simulate(composed(controller=table, **far, **order), 3, ["/plant/state"]).arrays["/plant/state"]
        assert len(state) == 600 and np.abs(state["angle"][:20]).max() > 2.0 * bounds["angle"]
        assert all(np.abs(state[name][400:]).max() < bound for name, bound in bounds.items())
    known = verdict_of(composed(controller={**asked, "information": "applied"}))
    assert known.state == "undecided" and "ends_surely_within" not in known.details


def test_gains_that_lead_away_seldom_end_within_in_the_mean_and_often_are_undecided() -> None:
    """Two of the published H-infinity gains are positive; the more often they act, the further the loop ends."""
    late = {"network.ca.law": {"kind": "markov", "matrix": [[0.3, 0.7], [0.3, 0.7]]}}
    old = {"network.sc.law": {"kind": "markov", "matrix": [[0.1, 0.9, 0.0], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]]}}
    seldom, often, mostly = (hinf(**change).details.get("ends_from_anywhere_within") for change in ({}, late, late | old))
    assert isinstance(seldom, dict) and isinstance(often, dict) and 2.0 < seldom["angle"] < often["angle"] and mostly is None


def test_the_root_mean_square_loop_from_far_away_is_within() -> None:
    loop = compose(load_experiment("dc-motor-hinf-friction", **CALM | {"duration": 30, "plant.initial_angle_rad": 15.0}))
    bounds: Any = verdict_of(loop).details["ends_from_anywhere_within"]
    states, _ = many_runs(loop, 6)
    for name, bound in bounds.items():
        level = float(np.sqrt(np.mean(states[name][450:] ** 2, axis=1)).max())
        assert level < bound and (name == "speed" or level > bound / 1000), "friction holds it"
    assert (np.abs(states["angle"][:20]).max(axis=0) > 2.0 * bounds["angle"]).all()


def test_later_networks_end_further() -> None:
    at_once = {"network.sc.law": LATEST | {"age": 0}, "network.ca.law": LATEST | {"age": 0}}
    near, far = (bounds_of(verdict_of(composed(**change))) for change in (at_once, {}))
    assert far["angle"] > near["angle"] + 3 * 0.05 * 48.85 * 0.058


@pytest.mark.parametrize("side", ["network.sc", "network.ca"])
def test_a_loop_that_holds_what_it_had_for_any_time_ends_nowhere_surely(side: str) -> None:
    """In a burst of losses it leaves every bound; a clock of the sensor alone makes samples older than the law's ages."""
    lossy = {"kind": "packet", "latency": "5 ms", "loss": 0.5}
    changes: dict[str, Any] = {"controller": {"kind": "local", "gain": [[-0.05]]}}
    loop = compose(load_experiment("dc-motor-hinf-friction", **CALM | changes | {f"{side}.max_age": 1, f"{side}.law": lossy}))
    found = verdict_of(loop)
    assert found.state == "undecided" and "ends_surely_within" not in found.details and "surely" not in found.reason
    clock = {"network.nodes.sensor": {"outputs": ["angle"], "clock": {"every": 4}}}
    assert "surely" not in hinf(**changes, **clock).reason


class Takes(DCMotor):
    """Says that it saturates, and takes a tenth of what is beyond its limit."""

    def start(self, rng: np.random.Generator) -> Any:
        limit = self.driver.saturation_v or 0.0
        run = DCMotor(gain=self.gain, pole=self.pole).start(rng)

        class Run:
            def advance(self, dt_ns: int, u: Any, w: Any = ()) -> None:
                inside = float(np.clip(u[0], -limit, limit))
                all_of_it = float(np.clip(u[0] + sum(w), -limit, limit))
                run.advance(dt_ns, [all_of_it + 0.1 * (u[0] - inside)], [0.0])

            def __getattr__(self, name: str) -> Any:
                return getattr(run, name)

        return Run()


def test_a_plant_that_takes_more_than_its_limit_is_refused() -> None:
    changes: Any = {"controller": {"kind": "local", "gain": [[-0.1]]}, "duration": 1} | CALM
    verdicts = [
        verdict_of(compose(load_experiment("dc-motor-h2", plant=kind(driver=Driver(saturation_v=0.058)), **changes)))
        for kind in (DCMotor, Takes)
    ]
    assert [verdict.state for verdict in verdicts] == ["certified", "refused"]
    assert "departures() says at most" in verdicts[1].reason


def unstable(start: float, saturation: float = 1.0, gain: float = -4.0, **changes: Any) -> Loop:
    """A loop around x' = x + sat(u), from which nothing returns beyond |x| = saturation."""
    plant = {
        "kind": "state-space", "A": [[1.0]], "B": [[1.0]], "C": [[1.0]], "initial_state": [start], "saturation": [saturation],
    }  # fmt: skip
    fresh = {"network.sc.law": {"kind": "constant", "age": 0}, "network.ca.law": {"kind": "constant", "age": 0}}
    given = {"plant": plant, "controller": {"kind": "local", "gain": [[gain]]}, "duration": 6}
    return compose(load_experiment("dc-motor-hinf", **CALM | given | fresh | changes))


@pytest.mark.parametrize("start", [1.02, -1.02])
def test_a_start_from_which_no_command_brings_the_plant_back_is_refused(start: float) -> None:
    verdict = verdict_of(unstable(start))
    assert verdict.state == "refused" and verdict.number == pytest.approx(1.02) and "no controller" in verdict.reason
    assert "; while no command passes its limit the loop is mean-square stable" in verdict.reason
    for gain in (-2.0, -3.0, -4.5):
        ends = simulate(unstable(start, gain=gain), 0, ["/plant/state"]).arrays["/plant/state"]["x1"]
        assert abs(ends[-1]) > 1.2 and ends[-1] * start > 0.0


@pytest.mark.parametrize("change", [{"start": 0.98}, {"saturation": 1.05}])
def test_a_start_that_a_command_brings_back_is_not_refused(change: dict[str, float]) -> None:
    loop = unstable(**{"start": 1.02} | change)
    assert verdict_of(loop).state != "refused"
    assert abs(simulate(loop, 0, ["/plant/state"]).arrays["/plant/state"]["x1"][-1]) < 0.3


def test_a_disturbance_that_may_bring_the_plant_back_leaves_it_undecided() -> None:
    pulse = [{"at": 0.1, "samples": 5, "value": [-0.5]}]
    assert verdict_of(unstable(1.02, disturbance=pulse)).state == "undecided"
    assert verdict_of(unstable(1.6, disturbance=pulse)).state == "refused"
    together = unstable(1.6, gain=-2.0, disturbance=[{"at": 0.0, "samples": 28, "value": [-0.25]}] * 4)  # they add up
    assert verdict_of(together).state == "undecided"
    assert abs(simulate(together, 0, ["/plant/state"]).arrays["/plant/state"]["x1"][-1]) < 0.3


def test_a_design_with_integral_action_is_certified_where_its_sum_is_clamped() -> None:
    """What the clamped sum adds to the command is beside the friction; a sum of 400 rad slots would take the whole supply."""
    name = "dc-motor-ours-integral"
    small = compose(load_experiment(name, **CALM))
    assert isinstance(small.controller, SendAll)
    large = compose(load_experiment(name, controller=replace(small.controller, integral_limit=(400.0,)), **CALM))
    assert verdict_of(small).certified and "ends_from_anywhere_within" in verdict_of(small).details
    assert verdict_of(large).state == "undecided"
    assert small.controller.integral_limit == (2.0,)
    with pytest.raises(ExperimentError, match=r"controller\.integral_limit: needs integral above 0"):
        load_experiment("dc-motor-ours-h2", **{"controller.integral_limit": [2.0]})


@pytest.mark.parametrize("pushed", [False, True])
def test_a_run_that_waits_for_a_node_begins_elsewhere(pushed: bool) -> None:
    """Until a packet of the second node has come the input is 0, and the unstable part is lost, however near 0 it begins."""

    def lost(late: int) -> tuple[Verdict, bool]:
        plant = {"kind": "state-space", "A": [[8.0, 0.0], [0.0, -1.0]], "B": [[1.0], [1.0]], "C": [[1.0, 0.0], [0.0, 1.0]]}
        here: dict[str, Any] = {"max_age": 6, "law": {"kind": "constant", "age": 0}}
        nodes = {"a": {"outputs": ["y1"]}, "b": {"outputs": ["y2"], "law": {"kind": "constant", "age": late}}}
        start = [0.0, 0.0] if pushed else [1.0, 0.0]
        loop = compose(load_experiment(
            "dc-motor-h2", plant=plant | {"saturation": [40.0], "initial_state": start}, allow_uncertified=True, duration="4 s",
            limits={}, reference=[], disturbance=[{"at": "0 s", "samples": 1, "value": [16.0]}] if pushed else [],
            controller={"kind": "local", "gain": [[-10.0, 0.0]]},
            **{"network.sc": here, "network.ca": here, "network.nodes": nodes},
        ))  # fmt: skip
        state = simulate(loop, 0, ["/plant/state"]).arrays["/plant/state"]
        return verdict_of(loop), bool(abs(state["x1"][-1]) > 1e3)

    verdict, away = lost(0)
    assert verdict.certified and not away, verdict
    verdict, away = lost(6)
    assert away and verdict.state == "undecided" and "rows are zeros until a packet of every node has come" in verdict.reason


@pytest.mark.parametrize(("pole", "state"), [(0.4, "refused"), (-0.4, "undecided")])
def test_what_grows_within_its_limits_is_refused_where_no_command_holds_the_plant_from_afar(pole: float, state: str) -> None:
    """x' = 0.4 x + sat(u) under a gain that is too large: with 1 beside it x = 3 runs away, whatever the command."""
    plant = {"kind": "state-space", "A": [[pole]], "B": [[1.0]], "C": [[1.0]], "initial_state": [3.0], "saturation": [1.0]}
    loop = compose(load_experiment(
        "dc-motor-h2", plant=plant, controller={"kind": "local", "gain": [[-60.0]]}, reference=[], disturbance=[],
        allow_uncertified=True, limits={"watchdog_slots": 1000}, duration=20,
    ))  # fmt: skip
    assert loop.verdict is not None and loop.verdict.state == state, loop.verdict.reason
    end = abs(float(simulate(loop, 0).arrays["/plant/state"]["x1"][-1]))
    assert end > 100.0 if state == "refused" else end < 10.0
