"""`dc-motor-two-nodes`: the motor's angle and speed on sensor nodes of their own, certified, designed for, run and predicted."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from design.controllers import Known, MultiSampleController, Sample, SendAll
from design.networked_loop.prediction import predict_tracking
from hil.cli.page_text import print_summary
from hil.compose import compose
from hil.design_questions import tracking_target
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.rig.delay_chains import gains_over
from hil.rig.loop import Loop
from hil.rig.loop_chains import loop_chains
from hil.runtime.virtual import simulate
from hil.session import run_session
from hil.session.replay.replay import verify

EARLY = 'reference=[{at="0.1 s", value=[3.0, 0.0]}]'
FIXED = "controller={kind='send-all', ages=[2, 2], selection='constant', gains=%s}"
GAINS = [[[[-0.05, -0.008]]], [[[-0.05, -0.006]]], [[[-0.04, -0.007]]], [[[-0.035, -0.005]]]]


@pytest.fixture(scope="module")
def loop() -> Loop:
    return compose(load_experiment("dc-motor-two-nodes", [EARLY, "duration=1.5"]))


def test_it_is_designed_for_and_certified_over_all_ages(loop: Loop) -> None:
    assert isinstance(loop.controller, SendAll) and loop.controller.ages == (2, 2) and len(loop.controller.gains) == 4
    assert loop.verdict is not None and loop.verdict.certified and loop.verdict.details["modes"] == 8
    assert loop.verdict.number == pytest.approx(0.6649, abs=1e-3)
    K = np.array(loop.controller.gains)[:, 0, 0]
    assert np.abs(K[1] - K[2]).max() > 1e-3  # (0, 1) and (1, 0) have the same oldest age, and gains of their own


def test_older_samples_than_a_table_distinguishes_have_the_gains_of_its_last_age() -> None:
    """Samples of the angle are up to 1 slot old and have one gain: as two equal ones, in the verdict and in the run."""
    one = (FIXED % GAINS[:2]).replace("[2, 2]", "[1, 2]")
    loops = [compose(load_experiment("dc-motor-two-nodes", [said, EARLY])) for said in (one, FIXED % (GAINS[:2] * 2))]
    short, long = (loop.verdict for loop in loops)
    assert short is not None and long is not None and short.state == long.state == "certified"
    assert short.number == pytest.approx(long.number, rel=1e-9)
    runs = [simulate(loop, 0, ["/plant/state"]).arrays["/plant/state"]["angle"].tolist() for loop in loops]
    assert runs[0] == runs[1]


def test_over_a_bus_each_pair_of_ages_that_gains_distinguish_has_a_label_of_its_own() -> None:
    """Nodes take turns: the newest samples are 0 and 1 slots old, or 1 and 0; never does one gain act for both."""
    bus = 'network.media.bus={kind="round-robin", nodes=["angle", "speed"]}'
    ideal = [f'network.nodes.{name}.law={{kind="constant", age=0}}' for name in ("angle", "speed")]
    of = compose(load_experiment("dc-motor-two-nodes", [FIXED % GAINS, bus, *ideal, EARLY, "allow_uncertified=true"]))
    found = loop_chains(of.rig, of.chains, of.controller, of.model).sc
    assert found is not None
    assert sorted(found.label.tolist()) == [1, 2]
    assert found.held_outputs(2).tolist() == [[label == 2, label == 1] for label in found.label]  # what did not come is held


def test_mean_and_spread_of_the_runs_are_those_predicted(loop: Loop) -> None:
    """Error rate 0.1 % over all slots together (Bonferroni); with 60 runs a mean off by one standard deviation is seen."""
    sc, ca = loop.chains.sc, loop.chains.ca
    slots, runs = loop.experiment.slots, 60
    r = np.array([loop.reference().at(k) for k in range(slots)])
    reported = predict_tracking(
        loop.model.A, loop.model.B, loop.model.C, sc, ca, gains_over(loop.controller, loop.model, sc, ca), "applied", r,  # type: ignore[arg-type]
        period_s=loop.model.period_s, initial=loop.chains.initial(),
    )  # fmt: skip
    error = np.zeros((runs, slots, 2))
    for seed in range(runs):
        states = simulate(loop, seed, ["/plant/state"]).arrays["/plant/state"]
        error[seed] = np.column_stack([states["angle"], states["speed"]]) - r
    z = norm.isf(0.001 / (2 * 2 * slots))
    off = np.abs(error.mean(axis=0) - reported.error_mean)
    assert (off <= z * reported.error_sd / np.sqrt(runs) + 1e-4 * np.abs(r).max()).all()
    late = slice(6, slots)
    assert np.median(error.std(axis=0, ddof=1)[late, 0] / reported.error_sd[late, 0]) == pytest.approx(1.0, abs=0.25)


def test_the_input_is_the_gain_of_both_ages_times_what_both_nodes_said() -> None:
    """From the log alone: the newest sample of each node, its age, the table of these ages."""
    gains = np.array(GAINS)
    run = simulate(compose(load_experiment("dc-motor-two-nodes", [EARLY, "duration=1.5", FIXED % GAINS])), 3)
    draws, y, r = run.arrays["/network/sc"], run.arrays["/plant/measurement"], run.arrays["/reference"]
    rows = run.arrays["/controller/rows"]
    newest, used = [-1, -1], set()
    for k in range(30):
        for node in (0, 1):
            newest[node] = max([newest[node], *draws["packet_slot"][(draws["slot"] == k) & (draws["node"] == node)].tolist()])
        said = rows[next(name for name in rows.dtype.names if name.startswith("row"))][k] if rows["slot"][k] == k else None
        if min(newest) < 0:
            assert said == 0.0
            continue
        ages = [k - g for g in newest]
        used.add(tuple(ages))
        known = np.array([y["angle"][newest[0]], y["speed"][newest[1]]])
        error = known - np.array([r["angle"][k], r["speed"][k]])
        assert said == pytest.approx(float(gains[2 * ages[0] + ages[1]][0, 0] @ error), rel=1e-5, abs=1e-6)
    assert used == {(0, 0), (0, 1), (1, 0), (1, 1)}


def test_until_both_nodes_have_been_received_the_rows_are_zero() -> None:
    running = compose(load_experiment("dc-motor-two-nodes", [FIXED % GAINS])).start_controller()
    assert isinstance(running, MultiSampleController)
    angle, speed = Sample(0, 2, (1.0,)), Sample(1, 1, (5.0,))
    assert running.rows(2, Known((speed,), (0.0, 0.0))) == ((0.0,),)
    assert running.rows(2, Known((angle, speed), (0.0, 0.0))) == ((pytest.approx(-0.05 - 5 * 0.006),),)


def test_a_run_has_a_summary_per_node_and_replays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    experiment = load_experiment("dc-motor-two-nodes", ["duration=1", FIXED % GAINS])
    session = run_session(experiment, path=tmp_path / "a.mcap")
    nodes = session.summary["network"]["nodes"]
    assert session.status == 0 and set(nodes) == {"angle", "speed"}
    assert all(sum(node["mode_counts"]) == 20 for node in nodes.values())  # of a node its own draws alone
    assert sum(node["fates"]["delivered"] for node in nodes.values()) == session.summary["network"]["sc"]["fates"]["delivered"]
    print_summary(session.summary)
    heads = ("angle to controller", "speed to controller", "to actuator")
    reported = " ".join(capsys.readouterr().out.split())  # a row may go on below itself
    assert all(reported.count(head) == 1 for head in heads) and "no modes" not in reported
    counts = "/".join(map(str, nodes["speed"]["mode_counts"]))
    assert f"in {counts} slots; fits its law" in reported
    assert session.summary["units"]["sse"] == "rad² s"  # the angle is tracked, the speed is not
    assert verify(session.run).difference is None


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        (['reference=[{at="1 s", value=[3.0, 1.0]}]'],
         "reference[0].value: no input holds the 2 outputs at [3.0, 1.0]; the nearest that one holds are [3.0, 0.0]"),
        (['network.nodes.speed.outputs=["angle"]'],
         "network.nodes.speed.outputs[0]: 'angle' is measured by node 'angle' already"),
        (['network.nodes.speed.outputs=["angle"]'], "nodes: no node measures the output 'speed'"),
        (['network.nodes.speed.outputs=["torque"]'], "network.nodes.speed.outputs[0]: the plant has no output 'torque'"),
        (["network.nodes.speed.id=0", "network.nodes.angle.id=0"],
         "network.nodes.speed.id: 0 is the number of node 'angle' already"),
        (["plant.tachometer=false"], "the plant has no output 'speed'"),
        ([FIXED % GAINS[:2]], "controller.ages: [2, 2], expected counts whose product is 2"),
        ([(FIXED % GAINS).replace("[2, 2]", "[4]")], "controller.ages: [4], expected one number for each of 2 sensor nodes"),
        (["controller={kind='designed', output_weights=[1.0]}"], "controller.output_weights: length 1, expected 2: one"),
        (["controller={kind='designed', output_weights=[1.0, -1.0]}"], "controller.output_weights[1]: -1.0, expected"),
        (["controller={kind='designed', integral=0.1}"], "controller.integral: 1 inputs cannot make the mean errors of 2"),
        (["controller={kind='designed', sojourns=2}"], "sojourns"),
        (['network.nodes.speed.law={kind="iid-latency"}'], "network.nodes.speed.law"),
    ],
)  # fmt: skip
def test_a_fault_is_refused_with_its_place(sets: list[str], expected: str) -> None:
    base = [] if any("controller" in change for change in sets) else [FIXED % GAINS]
    with pytest.raises(HilError) as caught:
        compose(load_experiment("dc-motor-two-nodes", [*base, *sets]))
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ('network.media.bus={kind="round-robin", nodes=["angle", "speed"]}', "nodes share network.media.bus, and take turns"),
        ('network.nodes.angle.trigger={kind="error", threshold=0.1}',
         "network.nodes.angle.trigger (error) lets a node keep silent"),
        ("network.nodes.angle.clock={every=2}", "network.nodes.angle.clock: a node sends in one of 2 slots"),
        ('network.nodes.angle.law={kind="trace", ages=[0, 1, 0, 1]}', "the law of network.nodes.angle states no chain"),
    ],
)  # fmt: skip
def test_what_no_design_knows_is_judged_where_nothing_is_drawn_by_the_state(change: str, reason: str) -> None:
    changes = [FIXED % GAINS, change, "allow_uncertified=true", "duration=0.2"]
    found = compose(load_experiment("dc-motor-two-nodes", changes)).verdict
    assert found is not None and (found.state == "undecided" and reason in found.reason) == ("trigger" in change)
    with pytest.raises(HilError, match=rf"a design needs a chain of ages on both links, but .*{re.escape(reason)}"):
        compose(load_experiment("dc-motor-two-nodes", changes[1:]))


def test_gains_that_do_not_hold_the_loop_are_refused_by_the_same_chain() -> None:
    fast = [[[[-1.0, -0.1]]]] * 4
    with pytest.raises(HilError, match="not mean-square stable over this network"):
        compose(load_experiment("dc-motor-two-nodes", [FIXED % fast]))


def test_a_design_by_the_law_of_links_sc_alone_is_refused() -> None:
    with pytest.raises(HilError, match="dc-motor-two-nodes: several sensor nodes; hil run solves their gains"):
        tracking_target("dc-motor-two-nodes")


def test_gains_by_mode_have_no_certificate_over_several_nodes() -> None:
    """They did: the verdict was of the law of `network.sc`, whatever the nodes' own laws were."""
    nodes = 'network.nodes={a={outputs=["x1"]}, b={outputs=["x2", "mode"], law={kind="constant", age=0}}}'
    found = compose(load_experiment("smjls-robust-published", [nodes, "allow_uncertified=true"])).verdict
    assert found is not None and found.state == "undecided" and "several sensor nodes" in found.reason
