"""``hil design`` and ``hil bench design``: what they print, write and refuse."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from design.errors import DesignError
from hil.cli.design import QUESTIONS, command
from hil.cli.design_question import SHAPING, names_of
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
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
    words = ("dc-motor", "--information", "constant", "--starts", "1", "--uncertainty", "gain=1%")
    text = " ".join(run(*words).stdout.split())
    for said in (r"gains K\[tau\]\[row\] in V per rad, row by", r" H2 norm 3\.89", "mean-square stable",
                 r"margin of \(7\.28\) \d\S+ at gamma",
                 "gain 172.38 from 170.66 to 174.1, drifting or not",
                 r"uncertainty certified ", r"guaranteed H2 norm 4\.0[12]\d* guaranteed H-infinity 20\.\d+$"):  # fmt: skip
        assert re.search(said, text), said


def test_a_controller_with_a_state_is_shown_by_what_makes_it_and_no_ccl_finds_one():
    words = ("dc-motor", "--information", "constant", "--starts", "1", "--order", "1", "--reference-weight", "1")
    for more, sums, norm in (((), "", r"2\.[5-9]"), (("--integral", "0.01"), "then the sums of their errors, ", r"2\.[6-9]")):
        text = " ".join(run(*words, *more).stdout.split())
        known, numbers = f"all outputs, {sums}then the controller's own state", r"\S+ " * (2 + bool(sums))
        for said in (rf"\[row\] .* {known},", rf"slot, of {known} tau state 1 ─+ 0 {numbers}1 ", f" H2 norm {norm}"):
            assert re.search(said, text), said
    for option in ("--order", "--reference-weight"):
        with pytest.raises(HilError, match=f"{option[2:].replace('-', '_')}: the thesis's iterated linear matrix inequalities"):
            run("dc-motor", "--method", "ccl", option, "1")


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
        (("dc-motor", "--sojourns", "2"), "Markov network of dc-motor"),
        (("dc-motor-hinf", "--sojourns", "2"), "sojourns: only a semi-Markov law takes it"),
        (("no-such-thing",), "no-such-thing"),
        (("dc-motor", "--uncertainty", "mass=5%"), "--uncertainty: mass: .*gain.*pole"),
        (("dc-motor", "--robust"), "--robust: minimises the guaranteed H2 norm over --uncertainty; give one"),
        (("dc-motor", "--robust", "--uncertainty", "gain=5%", "--objective", "hinf"), "--robust: .*with --objective h2"),
        (("dc-motor", "--uncertainty", "gain=much"), "--uncertainty gain=much: expected NAME=PERCENT%"),
        (("dc-motor", "--uncertainty", "gain=-5%"), "--uncertainty gain=-5%: expected"),
        (("dc-motor", "--uncertainty", "initial_angle_rad=5%"), "initial_angle_rad: is 0"),
        (("dc-motor", "--local", "lqg", "--samples", "2"), "--samples: not with --local"),
        (("dc-motor", "--local", "lqg", "-o", "x.json"), "plant alone; --json > FILE.json keeps"),
        (("dc-motor", "--local", "lqg", "--noise", "0"), "--noise: 0.0, expected"),
        (("dc-motor", "--noise", "1"), "--noise: belongs to --local"),
        (("dc-motor", "--local", "lqg", "--network", "no.mcap"), "--network: not with --local"),
        (("dc-motor", "-o", "/no/such/directory/x.json"), "cannot be written: no folder"),
    ],
)
def test_bad_requests_are_refused_with_the_number_that_decides(arguments, message):
    with pytest.raises((HilError, DesignError), match=message):
        run(*arguments)


@pytest.mark.parametrize("weight", ["nan", "-1", "inf"])
def test_an_input_weight_that_is_none_is_refused(cli: Hil, weight: str) -> None:
    for question in ((), ("--trigger",)):
        status, _, err = cli("design", "dc-motor-ours-h2", "--input-weight", weight, *question)
        assert status == 2 and "'--input-weight': " in err and "expected a number from 0 to 1e+30" in " ".join(err.split())


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


def test_every_option_belongs_to_a_question_or_to_several_and_no_two_questions_have_one() -> None:
    own = [name for question in QUESTIONS for name in names_of(question.options)]
    known = {str(param.name) for param in command.params} - {"as_json"}
    assert len(own) == len({*own}) and {*own} | names_of(SHAPING) | {"subject", "path", "force"} == known
    assert len({question.place for question in QUESTIONS}) == len(QUESTIONS)
    for question in QUESTIONS:
        assert question.takes <= known and bool(question.name) != (question is max(QUESTIONS, key=lambda each: each.place))


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


def test_a_plant_of_ones_own_is_designed_for_by_its_file_and_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_main("new", "plant", "trolley") == 0
    done = run("trolley:Trolley", "--starts", "1", "-o", "gains.json")
    assert done.exit_code == 0 and json.loads(Path("gains.json").read_text())["verdict"]["state"] == "certified"
    with pytest.raises(HilError, match=r"trolley\.py has no 'Wagon'; it has Trolley"):
        run("trolley:Wagon")
