"""The problem set is what it says: results are computed again, bounds lie below them, a controller meets all of it."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from hil.errors import HilError
from hil.sweeps.problems import best_known, problems, reached
from tests.hil.cli.conftest import Hil, cli
from tests.hil.sweeps.problems.store import RUNS, best_of, lower_bound, store

__all__ = ["cli"]
NAMES = [problem.name for problem in problems()]


def test_ten_problems_each_with_a_best_known_controller_and_bounds_below_it() -> None:
    known = best_known()
    assert len(NAMES) == 10 == len(set(NAMES))
    assert set(known) == set(NAMES)
    assert sum(entry["lower_bound"] is not None for entry in known.values()) >= 6
    for problem in problems():
        entry = known[problem.name]
        assert entry["verdict"] == "certified" and entry["runs"] == RUNS and not entry["stopped"]
        assert entry["controller"] in problem.tried
        assert entry["low"] < entry["mean"] < entry["high"]
        bound = lower_bound(problem)
        assert (bound is None) == (entry["lower_bound"] is None)
        if bound is not None:
            assert bound == pytest.approx(entry["lower_bound"], rel=1e-6)
            assert 0.0 < bound < entry["low"], "the bound is of the sum times the period, as the mean is"


@pytest.mark.parametrize("name", ["motor-5g", "motor-ncsbench"])
def test_what_is_stored_is_computed_again(name: str) -> None:
    problem = next(problem for problem in problems() if problem.name == name)
    entry = best_known()[name]
    found = [reached(problem, table, RUNS if table == entry["controller"] else 100) for table in problem.tried]
    best = best_of(found)
    assert best is not None
    assert best.controller == entry["controller"]
    assert best.mean == pytest.approx(entry["mean"], rel=1e-3)  # gains are solved where they run


def test_no_mean_is_given_where_safety_stopped_a_run() -> None:
    problem = next(problem for problem in problems() if problem.name == "motor-bursty")
    found = reached(problem, "{kind='local',gain=[[-0.5]]}", 4)
    assert (found.runs, found.stopped, found.mean, found.said) == (4, 1, None, "safety stopped 1 of 4 runs")
    assert [reached(problem, problem.tried[0], runs).mean is None for runs in (1, 2)] == [True, False], "one run has no interval"


def test_a_mean_that_converges_badly_is_said_to() -> None:
    problem = next(problem for problem in problems() if problem.name == "motor-thesis")
    found = reached(problem, "{kind='local',gain=[[-0.325]]}", 4)
    assert found.verdict == "certified" and found.mean is not None
    assert "converges badly, and its interval is too narrow" in found.said


def test_the_best_of_the_controllers_that_were_tried_is_stored_beside_what_is_stored_of_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    path, stored = tmp_path / "best.json", {}
    for name in ("motor-ncsbench", "motor-5g"):
        problem = next(problem for problem in problems() if problem.name == name)
        store([problem], path, runs=4)
        tried = [reached(problem, table, 4) for table in problem.tried]
        for each, line in zip(tried, capsys.readouterr().out.splitlines(), strict=True):
            assert line.startswith(f"{name}: {each.controller}: {each.mean} ({each.low} to {each.high}) certified")
        best = min(tried, key=lambda each: each.mean or 0.0)
        stored[name] = msgspec.to_builtins(best) | {"lower_bound": lower_bound(problem)}
        assert json.loads(path.read_text()) == stored
    assert [*json.loads(path.read_text())] == sorted(stored)


def test_a_problem_on_which_no_controller_ran_is_refused_and_nothing_is_stored(tmp_path: Path) -> None:
    one = msgspec.structs.replace(problems()[0], tried=("{kind='local',gain=[[1.0,2.0,3.0]]}",))
    with pytest.raises(HilError, match="none of the controllers that are named ran"):
        store([one], tmp_path / "best.json", runs=4)
    assert not (tmp_path / "best.json").exists()


def test_a_controller_meets_all_problems_with_one_command(cli: Hil, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[controller]\nkind = 'local'\ngain = [[-0.1]]\n")
    status, out, err = cli("problems", "--controller", "mine.toml", "--runs", "4", "--json")
    assert status == 0, err
    said = json.loads(out)
    assert [*said] == NAMES
    ran = [name for name in NAMES if said[name]["yours"]["mean"] is not None]
    assert len(ran) >= 6
    for name in set(NAMES) - set(ran):
        assert said[name]["yours"]["said"]  # why it does not fit
    for name in ran:
        assert said[name]["yours"]["verdict"] in ("certified", "undecided", "refused")
        bound = said[name]["best_known"]["lower_bound"]
        assert bound is None or said[name]["yours"]["mean"] > 0.5 * bound  # 4 runs


def test_the_table_shows_every_problem(cli: Hil) -> None:
    status, out, _ = cli("problems")
    assert status == 0
    assert all(name in out for name in NAMES)
    assert "bound" in out and "motor-thesis (rad² s)" in out and "rank" not in out


@pytest.mark.parametrize(("words", "said"), [
    (["--only", "motor-thesi"], "no problem is called 'motor-thesi'"), (["--controller", "kind ="], "not valid TOML"),
    (["--controller", "gain = [[1.0]]"], "kind: missing"), (["--controller", "nowhere.toml"], "nowhere.toml: cannot be read"),
])  # fmt: skip
def test_faulty_requests_are_refused(cli: Hil, words: list[str], said: str) -> None:
    status, _, err = cli("problems", *words)
    assert status == 2
    assert said in err
