"""All runs at once: every bit as seed by seed, over every shipped experiment that is served; the rest is left alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from design.controllers.sensor_nodes import window_of
from design.historical_data.sensor_schedule import mask_of, window_mask
from hil.compose import compose
from hil.experiment import load_experiment
from hil.rig.loop import Loop
from hil.sweeps import lockstep, seeds
from hil.sweeps.batch_delivery import lawful
from hil.sweeps.lockstep import run_batch, supports_batch, swept_at_once
from hil.sweeps.seeds import run_one_by_one, run_seeds
from transport.laws.trace import TraceAge

SHIPPED = sorted(path.stem for path in (Path(hil.__file__).parent / "experiments").glob("*.toml"))
SERVED = {
    "dc-motor-1khz", "dc-motor-bursty", "dc-motor-h2", "dc-motor-h2-fast", "dc-motor-h2-friction", "dc-motor-hinf",
    "dc-motor-hinf-fast", "dc-motor-hinf-friction", "dc-motor-hinf-supply", "dc-motor-local", "dc-motor-local-fast",
    "dc-motor-ours-bursty", "dc-motor-ours-h2", "dc-motor-ours-hinf", "dc-motor-ours-integral", "dc-motor-ours-memory",
    "dc-motor-ours-mixed",
    "dc-motor-ours-stays", "dc-motor-ours-two-samples", "dc-motor-packets", "dc-motor-smith", "dc-motor-smith-fast",
    "dc-motor-two-nodes", "vtol-h2", "vtol-hinf", "vtol-ours-h2", "vtol-ours-hinf", "multisensor-lossy", "multisensor-newest",
    "multisensor-ours", "multisensor-published", "dc-motor-5g", "dc-motor-wifi",
}  # fmt: skip
ALONE = {
    "dc-motor-busy-can", "dc-motor-ours-busy-can", "multisensor-event", "omni-1khz", "omni-identify",
    "omni-materials", "omni-paces", "omni-push", "omni-slide", "omni-theorem61", "omni-wifi", "smjls-robust",
    "smjls-robust-published",
    "smjls-robust-reference", "vtol-delayed", "vtol-delayed-published", "vtol-fault", "vtol-fault-partitioned",
    "vtol-fault-published", "vtol-sensor-fault",
}  # fmt: skip
SEMI_MARKOV = "kind='semi-markov',matrix=[[0,1],[1,0]],sojourn=[{law='uniform',low=1,high=3},{law='geometric',p=0.5}]"
STRANGE_LAWS = (
    "network.ca.law={kind='iid',probabilities=[0.5,0.5]}",
    "network.ca.law={kind='iid',probabilities=[0.4,0.0,0.6],allow_gaps=true}",
    "network.ca.law={kind='trace',ages=[0,1,2,0,1]}",
    f"network.ca.law={{{SEMI_MARKOV}}}",
    "network.ca.law={kind='constant',age=1}",
    "network.ca.law={kind='markov',ages=[1,0],matrix=[[0.2,0.8],[0.5,0.5]],initial=[1.0,0.0]}",
)


def gains(tables: int, rows: int, inputs: int = 1, width: int = 1) -> str:
    rng = np.random.default_rng(1)
    return str((-0.05 * rng.random((tables, rows, inputs, width))).tolist())


def loop_of(name: str, *sets: str) -> Loop:
    return compose(load_experiment(name, ["allow_uncertified=true", *sets]), certify=False)


def same_bits(loop: Loop, chosen: range) -> None:
    together, alone = run_seeds(loop, chosen), run_one_by_one(loop, chosen)
    for a, b in zip(together, alone, strict=True):
        assert a.keys() == b.keys()
        for name in a:
            np.testing.assert_array_equal(a[name], b[name], err_msg=f"{name}, seed {b['seed']}")


def sent(selection: str, tables: int, rows: int, inputs: int = 1, width: int = 1, more: str = "") -> str:
    return f"controller={{kind='send-all',selection='{selection}',gains={gains(tables, rows, inputs, width)}{more}}}"


def test_every_shipped_experiment_is_in_one_of_the_lists() -> None:
    assert sorted(SERVED | ALONE) == SHIPPED


@pytest.mark.parametrize("name", ["vtol-fault-published", "multisensor-event", "smjls-robust-published"])
def test_what_is_not_served_is_run_seed_by_seed(name: str) -> None:
    loop = loop_of(name, "duration=1")
    assert not swept_at_once(loop)
    same_bits(loop, range(2))


SHORT = {
    "dc-motor-1khz": 1.3, "dc-motor-h2-friction": 12, "dc-motor-hinf-friction": 35, "dc-motor-packets": 12,
    "multisensor-newest": 8, "multisensor-published": 8,
}  # fmt: skip
SLOW = {  # their designs take 10 s
    "dc-motor-ours-hinf", "dc-motor-ours-integral", "dc-motor-ours-mixed", "dc-motor-two-nodes", "multisensor-lossy",
    "multisensor-ours",
}  # fmt: skip


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in sorted(SERVED)])
def test_a_shipped_experiment_has_the_bits_of_the_plain_engine(name: str) -> None:
    early = ("duration=8", "disturbance.0.at=5") if name.startswith("dc-motor") else ()  # instead of 50 s and 30 s
    loop = loop_of(name, *((f"duration={SHORT[name]}",) if name in SHORT else early))
    assert swept_at_once(loop)
    same_bits(loop, range(2))


def served_alike(loop: Loop) -> None:
    assert supports_batch(loop)
    same_bits(loop, range(4))


@pytest.mark.parametrize("law", STRANGE_LAWS)
def test_every_age_law_draws_the_same_ages(law: str) -> None:
    served_alike(loop_of("dc-motor-hinf", "duration=6", law, "controller={kind='local',gain=[[-0.03]]}"))


def test_one_named_node_moves_the_same() -> None:
    served_alike(loop_of("vtol-h2", "duration=2", "network.nodes={velocity={outputs=['vertical_velocity'],buffer=2}}"))


BURSTS = "loss={p_gb=0.2,p_bg=0.4,loss_good=0.1,loss_bad=0.9}"
PACKET_LAWS = {
    "lost and copied": "latency={table=[[0,'1 ms'],[0.5,'40 ms'],[0.5,'70 ms'],[1,'180 ms']]},loss=0.2,duplication=0.4",
    "in order": f"latency={{table=[[0,0],[1,'200 ms']]}},reordering=false,duplication=0.3,{BURSTS}",
    "a queue": "latency={table=[[0,0],[1,'120 ms']]},queue=4,duplication=0.1",
    "a trace": "latency={trace=['10 ms','lost','150 ms','0 ms','60 ms'],past_end='repeat'},duplication=0.5,loss=0.1",
    "a constant": "latency='50 ms',loss=0.05",
}


@pytest.mark.parametrize("way", ["sc", "ca"])
@pytest.mark.parametrize("law", PACKET_LAWS.values(), ids=PACKET_LAWS)
def test_a_packet_law_delivers_the_same_packets(law: str, way: str) -> None:
    loop = loop_of("dc-motor-packets", "duration=6", f"network.{way}.law={{kind='packet',{law}}}", "limits.watchdog_slots=40")
    assert supports_batch(loop) and run_batch(loop, range(6)).known.any()
    same_bits(loop, range(6))


@pytest.mark.parametrize(("selection", "rows"), [("constant", 1), ("generated", 4), ("previous", 4), ("both", 16)])
def test_a_packet_that_is_too_old_is_held_by_every_rule(selection: str, rows: int) -> None:
    late = "network.ca.law={kind='packet',latency={table=[[0,0],[1,'500 ms']]},loss=0.3}"
    same_bits(loop_of("dc-motor-packets", "duration=6", late, "limits.watchdog_slots=90", sent(selection, 4, rows)), range(3))


def test_a_run_that_the_watchdog_stops_and_one_whose_queue_overflows_are_the_plain_engine_s() -> None:
    starving = loop_of("dc-motor-packets", "duration=6", "network.ca.law={kind='packet',latency='1 ms',loss=0.5}",
                       "limits.watchdog_slots=5")  # fmt: skip
    full = loop_of("dc-motor-packets", "duration=6", "network.sc.law={kind='packet',latency={table=[[0,0],[1,0.4]]},queue=7}")
    for loop in (starving, full):
        assert 0 < run_batch(loop, range(12)).known.sum() < 12  # both kinds
        same_bits(loop, range(12))


@pytest.mark.parametrize(("selection", "rows"), [("constant", 1), ("generated", 2), ("applied", 2), ("previous", 2), ("both", 4)])
def test_every_rule_picks_the_same_row(selection: str, rows: int) -> None:
    same_bits(loop_of("dc-motor-hinf", "duration=6", sent(selection, 3, rows)), range(4))


@pytest.mark.parametrize(
    "sets",
    [
        [sent("applied", 3, 2, 1, 2, ",integral=true")],
        [sent("applied", 3, 2, 1, 2, ",integral=true,integral_limit=[0.4]")],
        [sent("applied", 3, 2, 1, 2, ",samples=2")],
        [f"network.sc.law={{{SEMI_MARKOV}}}", sent("applied", 4, 2, 1, 1, ",sojourns=[3,1]")],
        [f"network.ca.law={{{SEMI_MARKOV}}}", sent("applied", 3, 6, 1, 1, ",row_sojourns=3")],
    ],
    ids=["integral", "a clamped integral", "two samples", "sojourns", "row sojourns"],
)
def test_what_a_controller_remembers_is_the_same(sets: list[str]) -> None:
    same_bits(loop_of("dc-motor-hinf", "duration=6", *sets), range(4))


@pytest.mark.parametrize(
    "plant",
    [
        "plant.driver={saturation_v=0.058,dead_zone_v=0.0033,pwm_step_v=0.001}",
        "plant={kind='dc-motor',driver={saturation_v=0.06},disturbance_through_driver=true,encoder={step_rad=0.0038}}",
        "plant.load={torque_v=0.01,start_s=2.025,stop_s=4.01}",
        "plant.friction={viscous_v_s_per_rad=0.001}",
        "plant.friction={coulomb_v=0.0017,static_v=0.0026,stribeck_speed_rad_s=0.2}",
    ],
    ids=["driver", "through and encoder", "load", "viscous", "stribeck"],
)
def test_a_motor_moves_the_same(plant: str) -> None:
    served_alike(loop_of("dc-motor-hinf", "duration=6", plant))


def test_a_linear_plant_with_two_tracked_outputs_is_measured_the_same() -> None:
    plant = "plant={kind='state-space',A=[[0.0,1.0],[-2.0,-1.0]],B=[[0.0,1.0],[1.0,0.3]],C=[[1.0,0.0],[0.2,1.0]]}"
    sets = (plant, "reference=[{at=1.0,value=[1.0,-0.5]},{at=6.0,value=[0.5,-0.5]}]", "disturbance=[]", "limits={}")
    same_bits(loop_of("dc-motor-hinf", "duration=6", *sets, sent("applied", 3, 2, 2, 2)), range(4))


@pytest.mark.parametrize("limits", ["input=[0.47]", "state={angle=4.45}"])
def test_a_run_that_safety_stops_is_the_plain_engine_s(limits: str) -> None:
    loop = loop_of("dc-motor-hinf", "duration=6", f"limits={{{limits}}}")
    known = run_batch(loop, range(20)).known
    assert 1 < known.sum() < 19  # both kinds
    same_bits(loop, range(20))


def test_a_run_that_overflows_is_the_plain_engine_s() -> None:
    loop = loop_of("dc-motor-hinf", "controller={kind='local',gain=[[-50.0]]}", "limits={}", "duration=50")
    assert not run_batch(loop, range(3)).known.any()
    same_bits(loop, range(3))


NODES = ("duration=6", "network.ca.law={kind='markov',matrix=[[0.5,0.5],[0.7,0.3]]}")
EACH = f"controller={{kind='send-all',ages=[2,2],selection='generated',gains={gains(4, 2, 1, 2)}}}"
LATE = "network.nodes.speed.law={kind='packet',latency={table=[[0,0],[1,'160 ms']]},loss=0.2}"


@pytest.mark.parametrize(
    "sets",
    [(EACH,), (sent("applied", 2, 2, 1, 2),), (EACH, LATE), (sent("applied", 4, 2, 1, 2), "network.sc.max_age=3", LATE)],
    ids=["an age each", "the oldest", "a packet law", "the oldest over one"],
)  # fmt: skip
def test_several_nodes_are_received_the_same(sets: tuple[str, ...]) -> None:
    loop = loop_of("dc-motor-two-nodes", *NODES, *sets)
    assert supports_batch(loop) and len(loop.rig.sensors) == 2
    same_bits(loop, range(4))


@pytest.mark.parametrize(
    ("uses", "phases", "bus"),
    [("history", 4, "kind='round-robin',phase=1"), ("current-packet", 4, "kind='round-robin',loss=0.3"),
     ("last-packets", 16, "kind='round-robin',loss=0.3,phase=2"), ("current-packet", 4, "kind='random',loss=0.2"),
     ("last-packets", 25, "kind='random',loss=0.2"), ("history", 1, "")],
)  # fmt: skip
@pytest.mark.parametrize("law", ["kind='constant',age=0", "kind='constant',age=1", "kind='iid',probabilities=[0.6,0.4]"])
def test_gains_over_historical_data_take_the_same_samples(uses: str, phases: int, bus: str, law: str) -> None:
    if "iid" in law and uses != "history":
        pytest.skip("only the history takes packets of any age")
    media = f"network.media={{bus={{{bus},nodes=['first','second','third','fourth']}}}}" if bus else "network.media={}"

    def loop_with(K: np.ndarray) -> Loop:
        controller = f"controller={{kind='historical',uses='{uses}',gains={K.tolist()}}}"
        return loop_of("multisensor-published", "duration=2", controller, media, f"network.sc.law={{{law}}}")

    rng, nodes = np.random.default_rng(7), loop_with(np.zeros((phases, 4, 1, 4))).model.nodes
    K = 0.02 * rng.standard_normal((phases, 4, 1, 4)) * rng.integers(0, 2, (phases, 4, 1, 4))
    if uses == "last-packets" and nodes.turns is not None:
        K *= window_mask(nodes, window_of(nodes.turns, phases), 3)[:, :, None]
    elif "iid" not in law:
        K *= mask_of(nodes, 3, uses)[:, :, None]
    loop = loop_with(K)
    assert swept_at_once(loop) and run_batch(loop, range(3)).known.all()
    same_bits(loop, range(3))


def test_nodes_that_take_turns_or_have_clocks_are_received_the_same_and_silent_ones_left_to_the_plain_engine() -> None:
    oldest = sent("applied", 4, 2, 1, 2)
    turns = "network.media={bus={kind='round-robin',nodes=['angle','speed'],loss=0.1}}"
    clock = "network.nodes.angle.clock={every=3}"
    for change in (turns, clock):
        loop = loop_of("dc-motor-two-nodes", *NODES, oldest, "network.sc.max_age=3", "duration=3", change)
        assert supports_batch(loop)
        same_bits(loop, range(3))
    assert not supports_batch(loop_of("dc-motor-two-nodes", *NODES, EACH, clock))
    silent = "network.nodes={velocity={outputs=['vertical_velocity'],trigger={kind='magnitude',threshold=0.1}}}"
    assert not supports_batch(loop_of("vtol-h2", "duration=2", "allow_uncertified=true", silent))


class Liar(TraceAge):
    """A law that breaks its word: ages beyond the largest that it states."""

    @property
    def max_age(self) -> int:
        return 1


def test_a_law_that_breaks_its_word_is_left_to_the_plain_engine() -> None:
    ages = np.array([[0, 0], [1, 2], [0, 0]], dtype=np.int32)
    assert lawful(Liar(ages=(0, 1, 2)), ages).tolist() == [True, False]
    assert lawful(TraceAge(ages=(0, 1, 2)), ages).tolist() == [True, False]
    assert lawful(TraceAge(ages=(0, 1, 2), allow_gaps=True), ages).tolist() == [True, True]


def test_the_size_of_a_chunk_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = loop_of("vtol-hinf", "duration=6", "reference=[{at=0.5,value=[1.0]}]")
    whole = run_seeds(loop, range(11))
    monkeypatch.setattr(lockstep, "MOST_RUNS", 4)
    assert run_seeds(loop, range(11)) == whole
    assert [row["seed"] for row in whole] == list(range(11))


def test_a_sweep_in_lockstep_calls_no_plain_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> Any:
        raise AssertionError("the plain engine ran")

    monkeypatch.setattr(seeds, "run_one_by_one", refuse)
    values = seeds.run_sweep(load_experiment("dc-motor-hinf", ["duration=2"]), range(30), workers=seeds.here(-1)).values
    assert values["sse"].size == 30
    with pytest.raises(AssertionError, match="the plain engine ran"):
        seeds.run_seeds(loop_of("smjls-robust-published", "duration=1"), range(1))


def test_a_measure_without_a_batch_form_is_said_once() -> None:
    mine = loop_of("dc-motor-hinf", "duration=1", 'report.measures=["tracking", "haptics"]')
    reported = lockstep.measured_alone(mine)
    assert reported.startswith("1 of 2 measures run at once; haptics runs alone") and not swept_at_once(mine)
    assert lockstep.measured_alone(loop_of("dc-motor-hinf", "duration=1")) == ""
    silent = loop_of("vtol-fault", "duration=1", 'report.measures=["tracking", "haptics"]')
    assert not supports_batch(silent) and lockstep.measured_alone(silent) == "", "no measure is at fault where the loop is"
