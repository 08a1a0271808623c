"""What is predicted of an experiment is what its runs do: 400 runs each, every number within four standard errors.

Each comparison errs with probability 6e-5 under a right prediction (a normal mean; skewed sums some times more), so that all
of them together err in less than one of a hundred; a mean that is off by six standard errors is seen with probability 0.98.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as struct_replace

from hil.compose import compose
from hil.experiment import load_experiment
from hil.measure.prediction import PredictedSum, drive_of, left_out, predict
from hil.rig.missing_packets import watchdog_chance
from hil.sweeps.seeds import run_seeds
from plants.dc_motor import DCMotor, LoadTorque
from plants.parts.protocols import PlantRun

RUNS = 400
ROUNDING = 1e-11
"""Packets carry float32: an error settles at some 1e-7 of an angle of 3 rad, its square summed over seconds at 1e-13."""

HIDDEN = 20.0
"""A sum whose sd is so many times its mean is made by runs too rare for 400; its mean says nothing."""


def z_of(each: PredictedSum, rows: list[dict[str, float]]) -> float:
    values = np.array([row[each.name] for row in rows])
    assert np.isfinite(values).all()
    gap = max(abs(values.mean() - each.mean) - ROUNDING, 0.0)
    return gap / (each.sd / np.sqrt(len(values))) if gap else 0.0


def assert_predicted(name: str, changes: list[str], runs: int = RUNS) -> None:
    loop = compose(load_experiment(name, changes), certify=False)
    found = predict(loop, loop.experiment.slots)
    assert found is not None and not found.left_out
    rows = run_seeds(loop, range(runs))
    assert not any(row["stopped"] for row in rows)
    judged = [each for each in found.sums if each.sd < HIDDEN * each.mean]
    assert "sse" in {each.name.partition(".")[0] for each in judged}
    assert {each.name: z for each in judged if (z := z_of(each, rows)) >= 4.0} == {}


VARIED = [
    ("dc-motor-ours-h2", ["plant.initial_angle_rad=1.0"]),
    ("dc-motor-ours-two-samples", ["plant.initial_angle_rad=1.0", "plant.initial_speed_rad_s=5.0"]),
    ("dc-motor-ours-h2", ["plant.load.torque_v=0.02"]),
    ("dc-motor-hinf", ["plant.load={torque_v=-0.05, start_s=2.013, stop_s=6.5}", "plant.initial_speed_rad_s=-4.0"]),
    ("dc-motor-two-nodes", ["plant.initial_speed_rad_s=8.0"]),
]


@pytest.mark.parametrize(("name", "changes"), VARIED)
def test_first_state_and_loads_are_in_the_prediction(name: str, changes: list[str]) -> None:
    assert_predicted(name, ["duration=12 s", *changes])


@pytest.mark.parametrize("integral", ["0", "0.01"])
def test_a_state_of_the_controllers_own_is_in_the_prediction_from_its_first_sample_on(integral: str) -> None:
    """The first sample comes up to two slots late; until then the state stays, and the sum beside it."""
    own = f"controller={{kind='designed', order=1, reference_weight=3, input_weight=0.5, integral={integral}}}"
    changes = [own, "reference.0.at=0.1", "plant.initial_angle_rad=1.0", "duration=4 s", "limits={}"]
    assert_predicted("dc-motor-ours-memory", changes)


def test_more_moments_than_are_computed_are_none() -> None:
    """Nine states were a prediction of 1.2 GB."""
    gains, own = np.full((3, 2, 1, 13), -0.01), np.full((3, 12, 13), 0.01)
    table = f"controller={{kind='send-all', gains={gains.tolist()}, state_gains={own.tolist()}}}"
    loop = compose(load_experiment("dc-motor-ours-memory", [table]), certify=False)
    assert predict(loop, 40) is None


def test_the_samples_before_slot_0_are_the_first_one() -> None:
    """Half a second, before anything has died out: the sample that the first packet repeats is most of what is seen."""
    changes = ["duration=0.5 s", "reference.0.at=0.4", "disturbance=[]", "plant.initial_angle_rad=2.0"]
    assert_predicted("dc-motor-ours-two-samples", changes)


@pytest.mark.parametrize("information", ["generated", "previous", "both", "applied"])
def test_an_actuator_without_a_packet_takes_the_row_of_the_longest_delay(information: str) -> None:
    """Three delays to the actuator, the first packet one slot late: the row for 1 instead of 2 is 6 standard errors away."""
    late = "{ kind = 'markov', matrix = [[0.5, 0.5, 0], [0.4, 0.2, 0.4], [0.3, 0.3, 0.4]], initial = [0.0, 1.0, 0.0] }"
    changes = ["duration=0.5 s", "reference=[]", "disturbance=[]", f"controller.information={information}"]
    assert_predicted("dc-motor-ours-h2", [*changes, f"network.ca.law={late}", "plant.initial_angle_rad=2.0"], 3400)


@pytest.mark.slow
def test_every_shipped_experiment_has_a_known_answer() -> None:
    """Which have a prediction, which of these leave something out; a new experiment must be put into the study."""
    predicted: set[str] = set()
    simplified: set[str] = set()
    for path in sorted(Path("hil/experiments").glob("*.toml")):
        loop = compose(load_experiment(path.stem), certify=False)
        found = predict(loop, loop.experiment.slots)
        if found is not None:
            (simplified if found.left_out else predicted).add(path.stem)
    assert predicted == {*WHOLE, *SHORT}
    friction = {"dc-motor-h2-friction", "dc-motor-hinf-friction", "dc-motor-hinf-supply"}
    assert simplified == friction | {"omni-identify"}


WHOLE = [
    "dc-motor-1khz", "dc-motor-5g", "dc-motor-bursty", "dc-motor-h2", "dc-motor-h2-fast", "dc-motor-hinf",
    "dc-motor-hinf-fast", "dc-motor-local-fast", "dc-motor-ours-bursty", "dc-motor-ours-h2", "dc-motor-ours-hinf",
    "dc-motor-ours-memory", "dc-motor-ours-mixed", "dc-motor-ours-stays", "dc-motor-ours-two-samples", "dc-motor-packets",
    "dc-motor-two-nodes", "dc-motor-wifi", "vtol-h2", "vtol-hinf", "vtol-ours-h2", "vtol-ours-hinf",
]  # fmt: skip
SHORT = {"dc-motor-local": "2 s"}
"""Not mean-square stable: safety stops its runs later on, and a mean is made of the rarest ones."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [*WHOLE, *SHORT])
def test_a_shipped_experiment_runs_as_predicted(name: str) -> None:
    assert_predicted(name, [f"duration={SHORT[name]}"] if name in SHORT else [])


def test_what_is_left_out_is_named() -> None:
    said = {name: predict(compose(load_experiment(name), certify=False), 4) for name in ("dc-motor-h2-friction", "omni-identify")}
    friction, noisy = (found.left_out for found in said.values() if found is not None)
    assert "dry friction" in friction and "any load" in friction
    assert noisy == ("the plant's noise",)


class Thrown(DCMotor):
    """Nobody knows where it begins."""

    def start(self, rng: np.random.Generator) -> PlantRun:
        return DCMotor(initial_angle_rad=float(rng.normal()), load=LoadTorque(torque_v=0.02)).start(rng)


def test_of_a_plant_that_chance_moves_no_drive_is_predicted() -> None:
    loop = compose(struct_replace(load_experiment("dc-motor-h2"), plant=Thrown()), certify=False)
    assert left_out(loop) == ("any load", "the plant's noise")
    assert not drive_of(loop, 9)[1].any()


@pytest.mark.parametrize(("watchdog", "loss", "above"), [(2, "{p_gb=0.05, p_bg=0.4, loss_bad=0.7}", 0.1), (3, "0.15", 0.0)])
def test_how_often_the_watchdog_stops_a_run_is_named(watchdog: int, loss: str, above: float) -> None:
    """Nothing is predicted of a run that is stopped; 300 runs lie within 4 standard errors."""
    law = f"{{kind='packet', latency={{dist='uniform', loc='10 ms', scale='60 ms'}}, loss={loss}}}"
    changes = [f"network.ca={{law={law}, max_age=2}}", f"limits.watchdog_slots={watchdog}", "duration=2 s"]
    constant = "controller={kind='send-all', gains=[[[[-0.08]]]], selection='constant'}"
    loop = compose(load_experiment("dc-motor-hinf", [*changes, constant, "network.sc.law={kind='constant', age=0}"]))
    chance, found = watchdog_chance(loop.chains, loop.experiment, loop.model.d_max), predict(loop, 40)
    share = float(np.mean([bool(row["stopped"]) for row in run_seeds(loop, range(300))]))
    assert abs(share - chance) <= 4.0 * np.sqrt(chance * (1.0 - chance) / 300.0) and chance > above
    assert found is not None and any("the watchdog, which stops" in text for text in found.left_out)
    assert loop.verdict is not None and any("the watchdog stops" in text for text in loop.verdict.assumptions)


def test_viscous_friction_is_in_the_prediction() -> None:
    viscous, faster = (
        predict(compose(load_experiment("dc-motor-h2", [change]), certify=False), 100)
        for change in ("plant.friction.viscous_v_s_per_rad=0.02", f"plant.pole={3.5287 + 172.38 * 0.02!r}")
    )
    assert viscous is not None and faster is not None
    assert viscous.left_out == () and viscous.sums[0].mean == pytest.approx(faster.sums[0].mean, rel=1e-9)


def test_an_output_that_follows_nothing_is_in_no_sum() -> None:
    loop = compose(load_experiment("dc-motor-two-nodes", ["duration=6 s"]), certify=False)
    found = predict(loop, loop.experiment.slots)
    assert found is not None and found.names == ("angle",)
    assert [(each.name, each.unit, each.outputs) for each in found.sums] == [
        ("sse", "rad² s", ("angle",)), ("sse_after_5s", "rad² s", ("angle",)),
    ]  # fmt: skip


WHOLE_SUM = "controller.integral_limit=[]"
IDEAL = ["plant.driver={}", "plant.friction={}", "plant.encoder={}"]
GAPS = "{ kind = 'markov', matrix = [[0.2, 0.3, 0.5], [0.6, 0.1, 0.3], [0.3, 0.3, 0.4]], allow_gaps = true }"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("dc-motor-ours-integral", [*IDEAL, WHOLE_SUM]),
        ("dc-motor-ours-integral", [*IDEAL, WHOLE_SUM, "plant.load.torque_v=0.1", "plant.initial_angle_rad=-1.0"]),
        ("dc-motor-ours-h2", [f"network.sc.law={GAPS}", "plant.initial_angle_rad=0.5"]),
        ("dc-motor-hinf", [f"network.sc.law={GAPS}", "plant.load.torque_v=-0.03"]),
        ("dc-motor-two-nodes", ["plant.load.torque_v=0.03", "plant.initial_angle_rad=0.5", "limits.input=[20.0]"]),
        ("dc-motor-ours-two-samples", ["plant.load.torque_v=0.03", f"network.sc.law={GAPS}"]),
        ("dc-motor-ours-mixed", ["reference.0.at=0", "plant.initial_angle_rad=-1.0"]),
        ("vtol-ours-h2", ["reference.0.at=0"]),
    ],
)
def test_variations_run_as_predicted(name: str, changes: list[str]) -> None:
    assert_predicted(name, changes)


@pytest.mark.parametrize("rule", ["generated", "previous", "both"])
def test_first_rows_of_a_longer_delay_than_the_law_has_are_not_predicted(rule: str) -> None:
    """Packets have rows for d up to 3, and d is 1 or 2: in the first slots the actuator takes rows of d = 3."""
    rows = [[[-0.01 * (1 + row)]] for row in range(16 if rule == "both" else 4)]
    law = "{kind='markov', matrix=[[0.9, 0.1], [0.5, 0.5]], ages=[1, 2]}"
    ways = ["network.sc={law={kind='constant', age=0}}", f"network.ca={{max_age=3, law={law}}}", "disturbance=[]"]
    table = f"controller={{kind='send-all', selection='{rule}', gains=[{rows}]}}"
    late, at_once = "reference=[{at='1 s', value=[1.0]}]", "plant.initial_angle_rad=1.0"
    assert_predicted("dc-motor-h2", [*ways, table, late, "duration=3", "limits={}"], 100)
    moves = compose(load_experiment("dc-motor-h2", [*ways, table, late, at_once, "limits={}"]), certify=False)
    assert predict(moves, 20) is None


@pytest.mark.parametrize("name", ["dc-motor-ours-stays", "dc-motor-ours-bursty"])
def test_stays_that_began_before_the_run_are_not_predicted_where_the_gains_count_them(name: str) -> None:
    """Of a step at slot 1 theory had half the squared error: its stays are as long as in the long run, and rows count from 0."""
    late, at_once = (f"reference=[{{at={at}, value=[0.3]}}]" for at in (1.0, 0.05))
    assert_predicted(name, [late, "disturbance=[]", "duration=4"], 100)
    assert predict(compose(load_experiment(name, [at_once]), certify=False), 20) is None
