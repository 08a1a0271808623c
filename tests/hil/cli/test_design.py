"""``hil design`` and ``hil bench design``: what they print, write and refuse."""

import dataclasses
import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from click.testing import CliRunner

from design.requests.tracking import LocalDesigned, solve_tracking
from hil.cli.design import command
from hil.cli.design_answers import design_local
from hil.compose.loop import compose
from hil.design_questions.design_problem import problem_for, tracking_target, verdict_on
from hil.design_questions.plant_uncertainty import interval, judge_uncertain, plants_between
from hil.errors import HilError
from hil.experiment import load_experiment
from plants import LinearRun, Signal, StateSpace
from plants.parts.actuators import Friction
from tests.bench.design import GOALS, bench_design
from tests.hil.cli.conftest import Hil, run_main


def run(*arguments):
    return CliRunner().invoke(command, list(arguments), catch_exceptions=False)


def test_json_is_one_object_with_gains_norms_and_certificate():
    result = run("dc-motor", "--json")
    found = json.loads(result.stdout)
    assert result.exit_code == 0
    assert found["norms"]["h2"] <= 3.4697 and found["certificate"]["stable"]
    assert found["verdict"]["state"] == "certified" and found["verdict"]["number"] < found["verdict"]["limit"] == 1.0
    assert len(found["gains"]) == 3 and len(found["gains"][0]) == 2
    assert found["lower_bounds"]["h2_delayed_information"] < found["norms"]["h2"]


def test_table_shows_gains_and_certificate():
    result = run("vtol", "--information", "constant")
    assert "H2 norm" in result.stdout and "mean-square stable" in result.stdout


def test_file_is_a_design_that_loads(tmp_path):
    from design.tracking.design_file import load_design

    path = tmp_path / "design.json"
    run("dc-motor", "--information", "generated", "-o", str(path))
    assert load_design(path).selection == "generated"


def test_experiment_gives_plant_period_and_network():
    found = json.loads(run("dc-motor-hinf-fast", "--information", "tau", "--json").stdout)
    assert found["period_s"] == 0.025


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("dc-motor", "--gain-bound", "-1"), "design: gain_bound: -1"),
        (("dc-motor", "--hinf-bound", "17"), "design: hinf_bound: only a mixed design"),
        (("dc-motor", "--objective", "mixed", "--hinf-bound", "15"), "smallest H-infinity norm found is 16.27"),
        (
            ("vtol", "--period", "1", "--information", "constant"),
            "none in 4 starts of the search, best second-moment radius 1.*try samples = 2",
        ),
        (("dc-motor", "--sojourns", "2"), "Markov network of dc-motor"),
        (("dc-motor-hinf", "--sojourns", "2"), "sojourns: only a semi-Markov law takes it"),
        (("dc-motor", "--input-weight", "nan"), "--input-weight: nan"),
        (("no-such-thing",), "no-such-thing"),
        (("dc-motor", "--uncertainty", "mass=5%"), "--uncertainty: mass: .*gain.*pole"),
        (("dc-motor", "--robust"), "--robust: minimises the guaranteed H2 norm over --uncertainty; give one"),
        (("dc-motor", "--robust", "--uncertainty", "gain=5%", "--objective", "hinf"), "--robust: .*with --objective h2"),
        (("dc-motor", "--uncertainty", "gain=much"), "--uncertainty gain=much: expected NAME=PERCENT%"),
        (("dc-motor", "--uncertainty", "gain=-5%"), "--uncertainty gain=-5%: expected"),
        (("dc-motor", "--uncertainty", "initial_angle_rad=5%"), "initial_angle_rad: is 0"),
        (("dc-motor", "--local", "lqg", "--samples", "2"), "--samples: not with --local"),
        (("dc-motor", "--local", "lqg", "-o", "x.json"), "--output: not with --local"),
        (("dc-motor", "--local", "lqg", "--noise", "0"), "--noise: 0, expected"),
        (("dc-motor", "--noise", "1"), "--noise: belongs to --local"),
        (("dc-motor", "-o", "/no/such/directory/x.json"), "cannot be written: no folder"),
    ],
)
def test_bad_requests_are_refused_with_the_number_that_decides(arguments, message):
    with pytest.raises(HilError, match=message):
        run(*arguments)


@pytest.mark.parametrize("period", ["-0.1", "0", "0 ms"])
def test_a_period_that_is_none_is_refused(period):
    result = run("dc-motor", "--period", period)
    assert result.exit_code == 2 and "'--period': " in result.stderr and "expected a duration above 0 s" in result.stderr


def test_local_design_has_its_norms_and_the_verdict_over_the_network():
    found = json.loads(run("dc-motor-hinf", "--local", "lqg", "--json").stdout)
    assert found["without_network"]["radius"] < 1 and found["without_network"]["h2"] > 0
    assert found["verdict"]["state"] == "refused" and found["verdict"]["number"] > 1
    composed = compose(load_experiment("dc-motor-hinf", ['controller={kind="local-designed"}', "allow_uncertified=true"]))
    assert composed.verdict is not None and composed.verdict.number == pytest.approx(found["verdict"]["number"])
    assert np.asarray(found["law"]["A"]) == pytest.approx(np.asarray(composed.controller.A))
    assert "over the network" in run("dc-motor", "--local", "hinf").stdout


@cache
def plain_design():
    target = tracking_target("dc-motor")
    return target, solve_tracking(problem_for(target, starts=1))


def test_robust_gains_run_in_their_own_loop_and_are_not_solved_for_another(tmp_path):
    asked = ("dc-motor-hinf", "--information", "constant", "--starts", "1", "--uncertainty", "gain=30%")
    plain = json.loads(run(*asked, "--json").stdout)
    path = tmp_path / "robust.json"
    robust = json.loads(run(*asked, "--robust", "--json", "-o", str(path)).stdout)
    assert robust["robust"] and not plain["robust"] and robust["uncertainty"]["state"] == "certified"
    assert robust["uncertainty"]["margin"] > plain["uncertainty"]["margin"]
    controller = f"controller={{kind='designed', file='{path}'}}"
    assert compose(load_experiment("dc-motor-hinf", [controller])).controller.gains[0][0][0][0] == robust["gains"][0][0][0][0]
    with pytest.raises(HilError, match=r"robust gains are for their own loop \(B of the plant"):
        compose(load_experiment("dc-motor-hinf", [controller, "plant.gain=100"]))


def test_uncertainty_is_borne_undecided_or_refused_by_its_size():
    """The plants at the ends are the plant's own, and the guaranteed norms are above the nominal ones."""
    sure = json.loads(run("dc-motor", "--starts", "1", "--uncertainty", "gain=5%", "--json").stdout)
    reported = sure["uncertainty"]
    assert reported["state"] == "certified" and reported["number"] < reported["limit"] == 1.0
    assert reported["h2_norm"] > sure["norms"]["h2"] and reported["hinf_norm"] > sure["norms"]["hinf"]
    (one,) = reported["parameters"]
    assert one["low"] == pytest.approx(0.95 * 172.38) and reported["digest"] != sure["verdict"]["digest"]
    target, design = plain_design()
    louder = dataclasses.replace(design, gains=1.5 * design.gains)  # stable, with less to spare
    states = [judge_uncertain(target, louder, [interval(target.of, f"gain={width}%")]).state for width in (20, 50)]
    assert states == ["undecided", "refused"]


def test_one_family_decides_where_the_small_gain_theorem_proves_half():
    target, design = plain_design()

    def judged(gain, pole):
        return judge_uncertain(target, design, [interval(target.of, f"gain={gain}%"), interval(target.of, f"pole={pole}")])

    found = judged(10, 0.5)
    assert found.certified and "quadratic family" in found.method and found.number < found.limit == 1.0
    assert 0.4 < found.details["margin"] < 0.6 and found.details["worst_radius_at_the_ends"] < found.number
    wider = judged(15, 1.0)
    assert wider.state == "undecided" and "no quadratic family was found" in wider.reason
    assert wider.details["growth_of_one_family"] > 1.0 and judged(20, 1.5).state == "refused"


def test_what_a_plant_has_beyond_its_model_leaves_a_design_undecided():
    """Friction and an encoder that rounds are in no proof of a design; the same gains over the plain motor are certified."""
    target, plain = tracking_target("dc-motor-h2-friction"), tracking_target("dc-motor").of
    design = solve_tracking(problem_for(target, starts=1))
    verdict = verdict_on(target, design)
    assert verdict.state == "undecided" and "friction" in verdict.reason
    assert verdict_on(target._replace(of=plain), design).state == "certified"
    assert judge_uncertain(target, design, [interval(target.of, "gain=1%")]).state == "undecided"
    for of, state in ((target.of, "undecided"), (plain, "refused")):
        assert design_local(target._replace(of=of), LocalDesigned(method="lqr"))["verdict"]["state"] == state


def test_viscous_friction_moves_the_pole_that_a_design_is_judged_with():
    """The gains are made for the model that a designer sees; the verdict is on the motion, and between them is an uncertainty."""
    target, design = plain_design()
    motor, asked = target.of, [interval(target.of, "gain=0.1%")]
    rubbing = target._replace(of=dataclasses.replace(motor, friction=Friction(viscous_v_s_per_rad=0.1)))
    faster = target._replace(of=dataclasses.replace(motor, pole=motor.pole + 0.1 * motor.gain))
    plain, found = verdict_on(target, design), verdict_on(rubbing, design)
    assert found.number == verdict_on(faster, design).number < plain.number and found.digest != plain.digest
    margins = [judge_uncertain(each, design, asked).details["margin"] for each in (rubbing, target)]
    assert margins[0] < 0.01 * margins[1]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tank:
    """A level that is the volume over the area; it may move by another equation than it states."""

    area: float = 1.0
    moves_as_said: bool = True
    inputs: ClassVar = (Signal("flow", "m^3/s"),)
    outputs: ClassVar = (Signal("level", "m"),)
    states: ClassVar = (Signal("volume", "m^3"),)

    def model(self):
        return StateSpace(A=[[-0.1]], B=[[1.0]], C=[[1.0 / self.area]])

    def start(self, rng):
        return LinearRun(self.model() if self.moves_as_said else StateSpace(A=[[3.0]], B=[[-1.0]], C=[[1.0]]), (0.0,))


def test_a_design_for_a_plant_of_ones_own_is_judged_by_what_the_plant_does():
    moves = Tank().model().discretise(0.05)
    target = tracking_target("dc-motor")._replace(A=moves.A, B=moves.B, C=moves.C, of=Tank())
    design = solve_tracking(problem_for(target, starts=1))
    honest = verdict_on(target, design)
    assert honest.certified and any("moves as its model says" in each for each in honest.assumptions)
    lying = target._replace(of=Tank(moves_as_said=False))
    assert verdict_on(lying, design).state == "refused" and "does not move as its model()" in verdict_on(lying, design).reason
    assert design_local(lying, LocalDesigned(method="lqr"))["verdict"]["state"] == "refused"
    with pytest.raises(HilError, match=r"--uncertainty: area: changes what the plant measures \(C\)"):
        judge_uncertain(target, design, [interval(target.of, "area=50%")])


@pytest.mark.parametrize("names", [("gain=10%",), ("pole=30%",), ("gain=5%", "pole=20%")])
def test_every_plant_between_is_covered(names):
    """Plants of random parameters, none of them on the grid, lie in the set that the matrices describe."""
    target = tracking_target("dc-motor")
    intervals = [interval(target.of, said) for said in names]
    found = plants_between(target, intervals)
    rng = np.random.default_rng(1)
    for _ in range(200):
        values = {i.name: float(rng.uniform(i.low, i.high)) for i in intervals}
        other = dataclasses.replace(target.of, **values).model().discretise(0.05)
        change = np.hstack([other.A - target.A, other.B - target.B])
        N = np.hstack([found.N1, found.N2])
        delta = np.linalg.pinv(found.M) @ change @ np.linalg.pinv(N)
        assert np.linalg.norm(delta, 2) <= 1.0 + 1e-9
        np.testing.assert_allclose(found.M @ delta @ N, change, atol=1e-10)


def test_command_line_turns_refusal_into_status_2_and_writes_nothing(cli: Hil, tmp_path: Path) -> None:
    status, _, err = cli("design", "dc-motor", "--gain-bound", "0", "-o", "x.json")
    assert status == 2 and err.startswith("hil: design: gain_bound") and not (tmp_path / "x.json").exists()


@pytest.mark.slow
def test_bench_meets_a_goal_and_prints_the_other_route_beside_it():
    (row,) = bench_design(goals=GOALS[1:2], programmes=3)
    assert row["norm"] <= row["goal"] and row["ccl_norm"] > row["norm"]


@pytest.mark.slow
def test_every_goal_is_reached():
    """How long each took is the bench's to say: it depends on the machine."""
    assert [row["design"] for row in bench_design(programmes=0) if not row["reached"]] == []


def test_what_fits_no_law_loads_no_scipy_stats() -> None:
    """It takes half a second of CPU: only a measured network needs it, and a comparison in which a run was stopped."""
    code = (
        "import hil, hil.cli.design, hil.cli.design_answers, sys;"
        "print(hil.compare('dc-motor-hinf', 'dc-motor-h2', runs=20, jobs=1));"
        "assert 'scipy.stats' not in sys.modules"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True)


def test_a_plant_of_ones_own_is_designed_for_by_its_file_and_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_main("new", "plant", "trolley") == 0
    done = run("trolley:Trolley", "--starts", "1", "-o", "gains.json")
    assert done.exit_code == 0 and json.loads(Path("gains.json").read_text())["verdict"]["state"] == "certified"
    with pytest.raises(HilError, match=r"trolley\.py has no 'Wagon'; it has Trolley"):
        run("trolley:Wagon")
