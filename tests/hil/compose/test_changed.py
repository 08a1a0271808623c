"""A run that is changed while it goes on: which fields, what is claimed then, and what the network draws afterwards."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.compose import compose
from hil.compose.changed import changed, is_schedule
from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.log.read import read_run
from hil.log.run import Run
from hil.log.topics import APPLIED, CA, REFERENCE, SC, STATE, channels_of
from hil.log.write import MemorySink
from hil.pages.live.script import Scripted, read_script, script_of
from hil.rig.loop import Loop
from hil.runtime.changes import Change
from hil.runtime.virtual import run_virtual
from hil.session import Session, run_session
from hil.session.replay.recorded import ChangeRequest, changes_of
from hil.session.replay.replay import verify

LATE = {"kind": "markov", "matrix": [[0.1, 0.9], [0.1, 0.9]]}
LOSSY = {"kind": "packet", "latency": "1 ms", "loss": 0.8}
EVERYTHING: list[ChangeRequest] = [
    (20, "reference", [1.0]),
    (30, "network.ca.law", LATE),
    (40, "network.sc.law", {"kind": "packet", "latency": "30 ms", "loss": 0.3}),
    (50, "fault", {"kind": "corrupt", "for": 0.5, "link": "sc"}),
    (60, "disturbance", {"value": [0.2], "samples": 5}),
    (70, "controller", {"kind": "h2"}),
    (80, "fault", {"kind": "controller-restart", "for": 0.1}),
    (90, "network.ca.law.matrix", [[0.9, 0.1], [0.1, 0.9]]),
    (100, "fault", {"kind": "cut", "for": 0.1, "link": "ca"}),
]


@pytest.fixture(scope="module")
def motor() -> Loop:
    return compose(load_experiment("dc-motor-hinf", ["duration=6"]))


def run_with(name: str, asked: list[ChangeRequest], path: Path, **about: Any) -> Session:
    return run_session(load_experiment(name, **about), path=path, onlooker=Scripted(asked))


@pytest.mark.parametrize(
    ("path", "value", "reported"),
    [
        ("plant.gain", -3.0, "plant.gain"),
        ("plant.load.torque_v", 3.0, "plant.load.torque_v: does not change while it runs"),
        ("reference", [1.0, 2.0], "reference[0].value: length 2, expected 1: one for each output"),
        ("reference", "high", "].value"),
        ("reference.0", [1.0], "reference.0: does not change while it runs"),
        ("network.ca.law", {"kind": "markov", "matrix": [[0.5, 0.6], [0.7, 0.3]]}, "network.ca.law"),
        ("network.ca.law", {"kind": "constant", "age": 4}, "network.ca"),
        ("network.ca.max_age", 3, "the published gains cover tau <= 2 and d <= 1"),
        ("network.ca.law.matrix.7", [0.5, 0.5], "has entries 0 to 1"),
        ("controller", {"kind": "virtual-wall"}, "controller"),
        ("controller", {"kind": "unknown"}, "controller.kind"),
        ("fault", {"kind": "cut", "for": 0.1, "link": "ca", "node": "a"}, "both link and node"),
        ("disturbance", {"value": [0.1]}, "disturbance[0].samples: missing"),
        ("network.ca.law", {"kind": "markov", "matrix": "much"}, "network.ca.law.matrix"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_path(motor: Loop, path: str, value: Any, reported: str) -> None:
    with pytest.raises(ExperimentError) as refused:
        changed(motor, 10, path, value)
    assert reported in str(refused.value)


def test_what_the_nodes_of_the_run_cannot_take_is_refused() -> None:
    loop = compose(load_experiment("dc-motor-local-fast"))
    with pytest.raises(ExperimentError, match=r"network.ca.max_age: longest delay to the actuator: 3, and the run has 1"):
        changed(loop, 10, "network.ca.max_age", 3)


def test_rows_that_the_actuator_would_refuse_are_refused_before() -> None:
    """Two rows come where the rig takes eight: the watchdog would end a run that is certified."""
    loop = compose(load_experiment("dc-motor-ours-stays"))
    with pytest.raises(ExperimentError, match="lengths of stay with a row each: 1, and the run has 4"):
        changed(loop, 10, "controller", {"kind": "smith", "gain": [[-0.03]]})


def test_a_controller_goes_on_with_the_model_that_it_was_started_with() -> None:
    """A Smith predictor of a motor a quarter as strong: the loop grows, and with the new motor's model it would not."""
    loop = compose(load_experiment("dc-motor-smith-fast", ["controller.gain=[[-0.3]]"]))
    stronger = changed(loop, 10, "plant.gain", 600.0)
    assert stronger.verdict is not None and stronger.verdict.state == "refused"
    late = changed(stronger, 20, "network.sc.law.matrix", [[0.6, 0.4, 0.0], [0.7, 0.2, 0.1], [0.8, 0.1, 0.1]])
    assert late.verdict is not None and late.verdict.number == stronger.verdict.number
    again = changed(late, 30, "controller.gain", [[-0.3]])
    assert again.verdict is not None and again.verdict.certified, "one that begins anew knows the motor that runs"


def test_certificate_is_that_of_the_loop_that_would_run(motor: Loop) -> None:
    """The numbers are those of an experiment that says so from the beginning."""
    assert motor.verdict is not None and motor.verdict.certified
    for value, state in ((LATE, "certified"), (LOSSY, "refused")):
        after = changed(motor, 10, "network.ca.law", value)
        sets = [f"network.ca.law={_toml(value)}", "network.ca.max_age=1", "allow_uncertified=true"]
        alone = compose(load_experiment("dc-motor-hinf", sets))
        assert after.verdict is not None and alone.verdict is not None
        assert after.verdict.state == alone.verdict.state == state
        assert after.verdict.number == alone.verdict.number


def _toml(value: dict[str, Any]) -> str:
    return "{" + ", ".join(f"{k} = {v!r}" for k, v in value.items()) + "}"


def test_solved_gains_stay_where_the_network_changes() -> None:
    loop = compose(load_experiment("dc-motor-ours-hinf"))
    assert changed(loop, 10, "network.ca.law", LATE).controller == loop.controller


def test_a_network_that_is_replaced_keeps_its_largest_age(motor: Loop) -> None:
    whole, law = changed(motor, 10, "network.ca", {"law": LATE}), changed(motor, 10, "network.ca.law", LATE)
    assert whole.experiment.network == law.experiment.network != motor.experiment.network
    assert whole.verdict == law.verdict


def test_a_fault_that_is_over_takes_no_certificate_away(motor: Loop) -> None:
    broken = changed(motor, 10, "fault", {"kind": "cut", "for": 0.1, "link": "sc"})
    assert broken.verdict is not None and broken.verdict.reason.startswith("behind 1 fault on the time line")
    mended = changed(broken, 20, "network.ca.law", LATE)
    assert mended.verdict is not None and mended.verdict.certified and not mended.verdict.reason.startswith("behind")
    restarted = changed(motor, 10, "fault", {"kind": "controller-restart"})
    at_once, later = (changed(restarted, k, "network.ca.law", LATE).verdict for k in (10, 11))
    assert at_once is not None and at_once.certified and at_once.reason.startswith("behind")
    assert later is not None and later.certified and not later.reason.startswith("behind")


def test_a_trigger_does_not_see_that_a_fault_took_what_it_sent_when_that_is_over() -> None:
    node = "network.nodes.s={outputs=['angle'],trigger={kind='dead-band',threshold=0.05}}"
    banded = compose(load_experiment("dc-motor-h2", ["controller={kind='local',gain=[[-0.05]]}", node]))
    for link, certified in (("ca", True), ("sc", False)):
        broken = changed(banded, 10, "fault", {"kind": "cut", "for": 0.05, "link": link})
        for verdict in (broken.verdict, changed(broken, 40, "network.ca.law", LATE).verdict):
            assert verdict is not None and verdict.certified == certified


def test_claim_on_a_run_that_began_without_one_says_what_is_not_compared() -> None:
    loop = compose(load_experiment("dc-motor-local-fast", ["network.ca.law={kind='constant', age=1}", "allow_uncertified=true"]))
    assert loop.watched is None
    after = changed(loop, 5, "network.ca.law", {"kind": "constant", "age": 0})
    assert after.verdict is not None and after.verdict.certified
    assert any("not compared" in each for each in after.verdict.assumptions)


@pytest.mark.parametrize("law", [LATE, LOSSY], ids=["ages", "packets"])
def test_a_new_law_draws_from_a_stream_of_its_own_whatever_ran_before(tmp_path: Path, law: dict[str, Any]) -> None:
    """Two loops on one seed meet the same network behind the change, and the other direction draws what it drew."""
    k, patient = 37, ["limits.watchdog_slots=1000", "duration=4", "allow_uncertified=true"]
    other = [*patient, "network.ca.law={kind = 'constant', age = 1}", "network.ca.max_age=1"]
    asked: list[ChangeRequest] = [(k, "network.ca.law", law)]
    run, beside, plain = (
        run_session(load_experiment("dc-motor-hinf", sets), path=tmp_path / f"{i}.mcap", onlooker=looker).run
        for i, (sets, looker) in enumerate(((patient, Scripted(asked)), (other, Scripted(asked)), (patient, None)))
    )  # fmt: skip

    def of(run: Any, first: int, end: int) -> Any:
        draws = run.arrays[CA.name]
        return [draws[name][(draws["slot"] >= first) & (draws["slot"] < end)].tolist() for name in ("slot", "mode", "age")]

    assert of(run, k + 2, 80) == of(beside, k + 2, 80) != of(plain, k + 2, 80)
    assert of(run, 0, k) == of(plain, 0, k)
    assert np.array_equal(run.arrays[SC.name]["age"], plain.arrays[SC.name]["age"]), "the other direction draws what it drew"


def test_a_change_acts_from_its_slot_on(tmp_path: Path) -> None:
    pulse = {"value": [0.2], "samples": 3}
    asked: list[ChangeRequest] = [(20, "reference", [1.5]), (30, "disturbance", pulse), (40, "reference", [0.5])]
    run = run_with("dc-motor-hinf", asked, tmp_path / "a.mcap", duration="4").run
    r, w = run.arrays[REFERENCE.name]["angle"], run.arrays[APPLIED.name]["w_voltage"]
    assert r[19] == 3.0 * (19 >= 20) and r[20] == 1.5 == r[39] and r[40] == 0.5 == r[-1]
    assert np.flatnonzero(w).tolist() == [30, 31, 32]


def test_what_was_done_runs_again_to_the_same_log(tmp_path: Path) -> None:
    """The script of a log, and the log itself, give its SHA-256 again; a replay of it has the same bits."""
    first = run_with("dc-motor-hinf", [*EVERYTHING, (118, "end", None)], tmp_path / "a.mcap", duration="7")
    run = read_run(tmp_path / "a.mcap")
    assert [k for k, *_ in changes_of(run)] == [k for k, *_ in EVERYTHING] + [118]
    assert first.summary["slots"] == 118
    file = tmp_path / "script.jsonl"
    file.write_bytes(script_of(changes_of(run)))
    for again, source in ((tmp_path / "b.mcap", file), (tmp_path / "c.mcap", tmp_path / "a.mcap")):
        second = run_with("dc-motor-hinf", read_script(source), again, duration="7")
        assert second.summary["log"]["sha256"] == first.summary["log"]["sha256"]
    assert verify(run).likeness == "same bits"
    run.events[:] = [event for event in run.events if event["data"].get("path") != "reference"]
    assert verify(run).likeness == "different", "a replay leans on what was changed"


def test_a_run_that_may_be_changed_and_is_not_has_the_same_bits(motor: Loop) -> None:
    sinks = []
    for changes in (None, lambda k: ()):
        sink = MemorySink(channels_of(motor))
        run_virtual(motor, 0, sink, changes=changes)
        sinks.append(sink.payloads)
    assert sinks[0] == sinks[1]


def test_a_plant_goes_on_with_other_parameters_from_where_it_is(tmp_path: Path) -> None:
    """Dry friction comes in the run: the state does not jump, the record is that of no friction before, and the claim says so."""
    plain = run_session(load_experiment("dc-motor-hinf", ["duration=4"]), path=tmp_path / "a.mcap").run
    run = run_with("dc-motor-hinf", [(50, "plant.friction.coulomb_v", 0.02)], tmp_path / "b.mcap", duration="4").run
    before, after = plain.arrays[STATE.name], run.arrays[STATE.name]
    assert before["angle"][:51].tolist() == after["angle"][:51].tolist() and before["angle"][51] != after["angle"][51]
    assert verify(run).likeness == "same bits"
    loop = changed(compose(load_experiment("dc-motor-hinf")), 50, "plant.gain", 150.0)
    assert loop.verdict is not None and loop.verdict.certified
    assert any("parameters were changed" in each for each in loop.verdict.assumptions)


def test_the_hand_leads_the_device_from_where_it_is_without_an_impulse(tmp_path: Path) -> None:
    """The speed of a device whose hand is called elsewhere is continuous; other equations take a certificate of their own."""
    loop = compose(load_experiment("omni-1khz"))
    led = changed(loop, 500, "plant.hand.reach_m", -0.02)
    assert led.verdict is not None and led.verdict.certified and is_schedule(loop, "plant.hand.reach_m")
    assert not any("is stored" in said for said in led.verdict.assumptions)
    assert not is_schedule(loop, "plant.hand.stiffness_n_per_m")
    sets = ["duration=2", "plant.hand.approach_s=0.2"]
    looker = Scripted([(1000, "plant.hand.reach_m", -0.02)])
    run = run_session(load_experiment("omni-1khz", sets), path=tmp_path / "a.mcap", onlooker=looker).run
    state = run.arrays[STATE.name]
    assert abs(state["speed"][1001] - state["speed"][1000]) < 0.1 * np.abs(state["speed"]).max()
    assert state["position"][1000] > 0.0 > state["position"][-1]
    assert verify(run).likeness == "same bits"


def test_what_is_stored_in_a_wall_comes_back_when_it_is_changed(tmp_path: Path) -> None:
    """A wall of 20 N/m that 1 N presses becomes one of 1000 N/m: it gives 0.25 J, and the claim is not of that."""
    wall = "controller.wall={material=1,materials=[{stiffness_n_per_m=1000.0},{stiffness_n_per_m=20.0}]}"
    sets = [wall, "plant.hand={push={force_n=1.0}}", "duration=2", "limits={}"]
    loop, harder, stored = compose(load_experiment("omni-1khz", sets)), ("controller.wall.material", 0), "comes back, once"
    verdict = changed(loop, 1500, *harder).verdict
    assert loop.verdict is not None and not any(stored in said for said in loop.verdict.assumptions)
    assert verdict is not None and verdict.certified and any(stored in said for said in verdict.assumptions)
    run = run_session(load_experiment("omni-1khz", sets), path=tmp_path / "a.mcap", onlooker=Scripted([(1500, *harder)])).run
    assert run.arrays[STATE.name]["given"][1500] == 0.0 and run.arrays[STATE.name]["given"].max() > 0.1
    assert changed(loop, 1500, "reference", [0.0, 0.0, 0.0]).verdict == loop.verdict
    damped = compose(load_experiment("omni-1khz", [*sets[:-1], "limits.passivity={damping_n_s_per_m=30.0}"]))
    verdict = changed(damped, 1500, *harder).verdict
    assert verdict is not None and verdict.state == "undecided" and "comes back of what is stored" in verdict.reason


def test_the_cost_is_that_of_a_whole_run_without_disturbances() -> None:
    for sets, disturbed in ([], False), (["disturbance=[{at=1.0,samples=3,value=[5.0]}]"], True):
        loop = compose(load_experiment("multisensor-published", sets))
        assert loop.verdict is not None and loop.verdict.kind == "guaranteed cost"
        assert ("the cost is without disturbances" in loop.verdict.assumptions) == disturbed
    verdict = changed(loop, 20, "disturbance", {"value": [50.0], "samples": 2}).verdict
    assert verdict is not None and verdict.certified and verdict.kind == "mean-square stability"


NODES: list[ChangeRequest] = [
    (30, "network.nodes.angle.law", {"kind": "constant", "age": 0}),
    (50, "network.nodes.speed.law", {"kind": "constant", "age": 1}),
    (70, "network.ca.law", {"kind": "constant", "age": 0}),
]  # fmt: skip


def test_each_of_several_sensor_nodes_may_get_another_law(tmp_path: Path) -> None:
    about = ["duration=5", "limits.watchdog_slots=1000"]
    loop = compose(load_experiment("dc-motor-two-nodes", about))
    for k, path, value in NODES[:2]:
        loop = changed(loop, k, path, value)
    sets = [f"{path}={_toml(value)}" for _, path, value in NODES[:2]]
    alone = compose(load_experiment("dc-motor-two-nodes", [*about, *sets]))
    assert loop.verdict is not None and alone.verdict is not None and loop.verdict.certified
    assert [s.law for s in loop.rig.sensors] == [s.law for s in alone.rig.sensors]

    session = run_session(load_experiment("dc-motor-two-nodes", about), path=tmp_path / "a.mcap", onlooker=Scripted(NODES))
    draws = session.run.arrays[SC.name]
    for node, (k, _, value) in enumerate(NODES[:2]):
        ages = draws["age"][(draws["node"] == node) & (draws["slot"] >= k + 2) & (draws["age"] >= 0)]
        assert len(ages) and (ages == value["age"]).all()
        before = draws["age"][(draws["node"] == node) & (draws["slot"] < k) & (draws["age"] >= 0)]
        assert len(set(before.tolist())) > 1
    assert verify(read_run(tmp_path / "a.mcap")).likeness == "same bits"


@pytest.mark.parametrize(("name", "path", "text"), [
    ("dc-motor-two-nodes", "network.nodes.angle.outputs", "network.nodes.angle.law or network.nodes.speed.law"),
    ("dc-motor-two-nodes", "network.nodes.third.law", "of a sensor node its law may change in a run"),
    ("dc-motor-hinf", "network.nodes.angle.law", "of a sensor node its law may change in a run"),
    ("multisensor-ours", "network.nodes.first.law", "nodes on a shared medium keep their network"),
])  # fmt: skip
def test_of_sensor_nodes_nothing_else_changes(name: str, path: str, text: str) -> None:
    with pytest.raises(ExperimentError, match=text):
        changed(compose(load_experiment(name, ["allow_uncertified=true"])), 10, path, {"kind": "constant", "age": 0})


NOISY = "plant={kind='state-space', A=[[0,1],[0,-3.5287]], B=[[0],[172.38]], C=[[1,0]], measurement_noise=[0.01], \
process_noise=[0,0.5], saturation=[2.0]}"


def test_noise_and_limits_of_a_plant_change_and_their_random_numbers_go_on(tmp_path: Path) -> None:
    sets = [NOISY, "limits.state={}", "allow_uncertified=true", "duration=6", "disturbance=[]"]
    noises: list[ChangeRequest] = [(60, "plant.measurement_noise", [0.3]), (90, "plant.process_noise", [0, 0])]
    asked: list[ChangeRequest] = [*noises, (100, "plant.saturation", [0.01])]
    plain, free, run = (
        run_session(load_experiment("dc-motor-hinf", sets), path=tmp_path / f"{i}.mcap", onlooker=looker).run
        for i, looker in enumerate((None, Scripted(noises), Scripted(asked)))
    )

    def noise(of: Any) -> Any:
        return np.array(of.arrays["/plant/measurement"]["y1"]) - np.array(of.arrays[STATE.name]["x1"])

    before, after = noise(plain), noise(run)
    assert (before[:61] == after[:61]).all(), "the noise of slot 60 was drawn before the change"
    assert after[62:] == pytest.approx(30.0 * before[62:], rel=1e-6, abs=1e-9), "the same draws, thirty times as large"
    x2, held = free.arrays[STATE.name]["x2"], run.arrays[STATE.name]["x2"]
    assert (x2[:101] == held[:101]).all() and np.abs(held[101:]).max() < np.abs(x2[101:]).max()
    assert verify(read_run(tmp_path / "2.mcap")).likeness == "same bits"


def test_noise_that_was_turned_off_comes_back_with_the_draws_it_would_have_had(tmp_path: Path) -> None:
    sets = [NOISY, "limits.state={}", "allow_uncertified=true", "duration=4", "disturbance=[]"]
    asked: list[ChangeRequest] = [(20, "plant.measurement_noise", [0.0]), (40, "plant.measurement_noise.0", 0.01)]
    plain, run = (
        run_session(load_experiment("dc-motor-hinf", sets), path=tmp_path / f"{i}.mcap", onlooker=looker).run
        for i, looker in enumerate((None, Scripted(asked)))
    )
    noises = [np.array(of.arrays["/plant/measurement"]["y1"]) - np.array(of.arrays[STATE.name]["x1"]) for of in (plain, run)]
    assert (noises[1][22:40] == 0.0).all()
    assert noises[1][42:] == pytest.approx(noises[0][42:], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("field", ["process_noise", "measurement_noise", "saturation"])
def test_what_a_plant_has_cannot_end_in_a_run(field: str) -> None:
    """Without its forces the plant that took over had other inputs than its noise: the run ended in a traceback."""
    loop = compose(load_experiment("dc-motor-hinf", [NOISY, "limits.state={}", "allow_uncertified=true"]))
    with pytest.raises(ExperimentError, match=rf"plant\.{field}: \[\]: what a plant has neither begins nor ends"):
        changed(loop, 10, f"plant.{field}", [])


def test_a_plant_whose_own_way_changes_its_model_is_refused(motor: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(motor.experiment.plant), "own_way", lambda plant: ("gain",))
    with pytest.raises(ExperimentError, match=r"plant\.gain: changes the plant's model, and the plant says that it does not"):
        changed(motor, 10, "plant.gain", 170.0)


def test_a_noise_that_a_plant_does_not_have_cannot_begin_in_a_run() -> None:
    sets = [NOISY.replace("measurement_noise=[0.01], ", ""), "limits.state={}", "allow_uncertified=true"]
    loop = compose(load_experiment("dc-motor-hinf", sets))
    with pytest.raises(ExperimentError, match=r"plant\.measurement_noise: does not change while it runs .*process_noise"):
        changed(loop, 10, "plant.measurement_noise", [0.1])


class Counted:
    """Keeps what is counted."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int]] = []

    def counted(self, done: int, total: int) -> None:
        self.seen.append((done, total))


def test_a_script_counts_its_changes_while_it_composes_them(motor: Loop) -> None:
    counter = Counted()
    Scripted(EVERYTHING[:3], working=nullcontext(counter)).begin(motor, {})
    assert counter.seen == [(1, 3), (2, 3), (3, 3)]


@pytest.fixture(scope="module")
def regional() -> Loop:
    return compose(load_experiment("dc-motor-hinf-supply"))


@pytest.mark.parametrize(
    ("path", "value"), [("reference", [30.0]), ("disturbance", {"value": [1.0], "samples": 40}), ("plant.gain", 160.0)]
)
def test_a_region_is_of_where_a_run_begins_and_not_of_where_it_is_changed(regional: Loop, path: str, value: object) -> None:
    loop = regional
    assert loop.verdict is not None and loop.verdict.certified and loop.verdict.kind == "stability in a region"
    assert loop.verdict.quantity == "bound of the probability of leaving the region in the first 1000 slots"
    verdict = changed(loop, 100, path, value).verdict
    assert verdict is not None and verdict.state == "undecided" and "where its state is then is not known" in verdict.reason


def test_a_start_from_which_nothing_returns_is_not_where_a_run_is_changed() -> None:
    """A loop around x' = x + sat(u) comes to rest from 1.5 within a limit of 2, and would not within 1."""
    plant = "plant={kind='state-space',A=[[1.0]],B=[[1.0]],C=[[1.0]],initial_state=[1.5],saturation=[2.0]}"
    laws = [f"network.{way}.law={{kind='constant',age=0}}" for way in ("sc", "ca")]
    sets = [plant, "controller={kind='local',gain=[[-2.0]]}", *laws, "reference=[]", "disturbance=[]", "limits={}"]
    loop = compose(load_experiment("dc-motor-h2", [*sets, "allow_uncertified=true"]))
    weaker = compose(load_experiment("dc-motor-h2", [*sets, "allow_uncertified=true", "plant.saturation=[1.0]"]))
    assert weaker.verdict is not None and weaker.verdict.state == "refused"
    verdict = changed(loop, 100, "plant.saturation", [1.0]).verdict
    assert verdict is not None and verdict.state == "undecided" and "where its state is then is not known" in verdict.reason


def test_a_law_that_begins_anew_meets_the_other_direction_in_another_phase() -> None:
    """Both ages take turns. Begun together, tables of age 0 act alone; the law that takes over in the run meets age 1 with 0."""
    swaps = "kind='markov',matrix=[[0.0,1.0],[1.0,0.0]],initial=[1.0,0.0]"
    plant = "plant={kind='state-space',A=[[1.0]],B=[[1.0]],C=[[1.0]],initial_state=[1.0]}"
    table = "controller={kind='send-all',selection='applied',gains=[[[[-6.0]],[[-6.0]]],[[[50.0]],[[50.0]]]]}"
    laws = [f"network.{way}={{max_age=1,law={{{swaps}}}}}" for way in ("sc", "ca")]
    loop = compose(load_experiment("dc-motor-h2", [plant, table, *laws, "limits={}", "reference=[]", "disturbance=[]"]))
    assert loop.verdict is not None and loop.verdict.certified, loop.verdict
    assert any("meet in the phases in which they begin" in said for said in loop.verdict.assumptions)
    verdict = changed(loop, 101, "network.sc.law.initial", [0.0, 1.0]).verdict
    assert verdict is not None and verdict.state == "undecided" and "which phases of what repeats meet" in verdict.reason
    verdict = changed(loop, 101, "controller", {"kind": "local", "gain": [[-6.0]]}).verdict  # stable, whichever phases meet
    assert verdict is not None and verdict.certified and verdict.details["modes"] == 4
    assert any("any of their phases may meet" in said for said in verdict.assumptions)
    for gain, state in ((-20.0, "undecided"), (-24.0, "refused")):  # in one pair of phases it grows, in both
        found = changed(loop, 101, "controller", {"kind": "local", "gain": [[gain]]}).verdict
        assert found is not None and found.state == state
    assert "phases in which the loop grows least" in str(found.assumptions) and found.number == pytest.approx(1.1374, abs=1e-4)
    assert changed(loop, 101, "reference", [1.0]).verdict == loop.verdict


def test_a_law_that_begins_anew_meets_a_clock_in_another_phase() -> None:
    """Begun in slot 0 with the clock the loop decays, and is certified; the same law, begun anew in the run, lets it grow."""
    law = "{kind='markov',matrix=[[0.0,1.0],[1.0,0.0]],initial=[1.0,0.0]}"
    sets = ["plant={kind='state-space',A=[[3.0]],B=[[1.0]],C=[[1.0]],initial_state=[1.0]}", f"network.sc={{max_age=2,law={law}}}",
            "network.nodes={only={outputs=['y1'],clock={every=2}}}", "network.ca={max_age=0,law={kind='constant',age=0}}",
            "controller={kind='local',gain=[[-8.0]]}", "period=0.1", "duration=30", "limits={}", "reference=[]",
            "disturbance=[]"]  # fmt: skip
    loop, grown, path = compose(load_experiment("dc-motor-h2", sets)), [], "network.sc.law.initial"
    assert loop.verdict is not None and loop.verdict.certified
    for k in (100, 101):
        after = changed(loop, k, path, [1.0, 0.0])
        assert after.verdict is not None and after.verdict.state == "undecided"
        assert "which phases of what repeats meet" in after.verdict.reason
        sink, change = MemorySink(channels_of(loop), [STATE.name]), Change(path=path, value=[1.0, 0.0], loop=after)
        run_virtual(loop, 0, sink, changes=lambda slot, at=k, made=change: (made,) if slot == at else ())  # type: ignore[misc]
        x = np.abs(Run.from_memory(sink, summary={}).arrays[STATE.name]["x1"])
        grown.append(bool(x[-1] > 100.0 * x[k + 10]))
    assert grown == [True, False]
    faster = changed(loop, 100, "controller", {"kind": "local", "gain": [[-4.0]]}).verdict  # stable, whichever phases meet
    assert faster is not None and faster.certified
