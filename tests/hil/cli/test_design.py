"""``hil design`` and ``hil bench design``: what they print, write and refuse."""

import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from hil.bench.design import GOALS, bench_design
from hil.cli.design import command
from hil.errors import HilError


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
        (("dc-motor", "--period", "-0.1"), "--period: -0.1"),
        (("vtol", "--period", "1"), "smallest radius reached"),
        (("dc-motor", "--sojourns", "2"), "Markov network of dc-motor"),
        (("dc-motor-hinf", "--sojourns", "2"), "sojourns: for a semi-Markov law only"),
        (("dc-motor", "--input-weight", "nan"), "--input-weight: nan"),
        (("no-such-thing",), "no-such-thing"),
        (("dc-motor", "-o", "/no/such/directory/x.json"), "there is no folder"),
    ],
)
def test_bad_requests_are_refused_with_the_number_that_decides(arguments, message):
    with pytest.raises(HilError, match=message):
        run(*arguments)


def test_command_line_turns_refusal_into_status_2_and_writes_nothing(tmp_path):
    path = tmp_path / "x.json"
    code = f"from hil.cli import main; main(['design', 'dc-motor', '--gain-bound', '0', '-o', {str(path)!r}])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith("hil: design: gain_bound") and not path.exists()


def test_bench_meets_a_goal_and_prints_the_other_route_beside_it():
    (row,) = bench_design(goals=GOALS[1:2], programmes=3)
    assert row["norm"] <= row["goal"] and row["ccl_norm"] > row["norm"]


@pytest.mark.slow
def test_every_goal_is_met_in_its_time():
    assert [row["design"] for row in bench_design(programmes=0) if not row["met"]] == []
