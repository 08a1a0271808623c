"""The problem set is what it says: results are computed again, bounds lie below them, a controller meets all of it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import msgspec
import pytest

from hil.sweeps import problems as problem_set
from hil.sweeps.problems import RUNS, best_known, best_of, folder, lower_bound, problems, reached
from tests.hil.cli.conftest import Hil, cli

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
            assert 0.0 < bound < entry["low"]


@pytest.mark.parametrize("name", ["motor-5g", "motor-ncsbench"])
def test_what_is_stored_is_computed_again(name: str) -> None:
    problem = next(problem for problem in problems() if problem.name == name)
    entry = best_known()[name]
    found = [reached(problem, table, RUNS if table == entry["controller"] else 100) for table in problem.tried]
    best = best_of(found)
    assert best is not None
    assert best.controller == entry["controller"]
    assert best.mean == pytest.approx(entry["mean"], rel=1e-6)


def test_no_mean_is_given_where_safety_stopped_a_run() -> None:
    problem = next(problem for problem in problems() if problem.name == "motor-bursty")
    found = reached(problem, "{kind='local',gain=[[-0.5]]}", 4)
    assert (found.runs, found.stopped, found.mean, found.said) == (4, 1, None, "safety stopped 1 of 4 runs")
    assert [reached(problem, problem.tried[0], runs).mean is None for runs in (1, 2)] == [True, False], "one run has no interval"


@pytest.fixture
def own_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the set in which nothing is stored yet, of four runs each."""
    copy = shutil.copytree(folder(), tmp_path / "set", ignore=shutil.ignore_patterns("best.json", "*.py"))
    monkeypatch.setattr(problem_set, "folder", lambda: copy)
    monkeypatch.setattr(problem_set, "RUNS", 4)
    return copy / "best.json"


def test_the_best_of_the_controllers_that_were_tried_is_stored_beside_what_is_stored_of_others(cli: Hil, own_set: Path) -> None:
    stored = {}
    for name in ("motor-ncsbench", "motor-5g"):
        status, out, err = cli("problems", "--write", "--only", name)
        assert status == 0, err
        problem = next(problem for problem in problems() if problem.name == name)
        tried = [reached(problem, table, 4) for table in problem.tried]
        for each, line in zip(tried, out.splitlines(), strict=True):
            assert line.startswith(f"{name}: {each.controller}: {each.mean:.5g} ({each.low:.5g} to {each.high:.5g}) certified")
        best = min(tried, key=lambda each: each.mean or 0.0)
        stored[name] = msgspec.to_builtins(best) | {"lower_bound": lower_bound(problem)}
        assert json.loads(own_set.read_text()) == stored
    assert [*json.loads(own_set.read_text())] == sorted(stored)


def test_a_problem_on_which_no_controller_ran_is_refused_and_nothing_is_stored(
    cli: Hil, own_set: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = msgspec.structs.replace(problems()[0], tried=("{kind='local',gain=[[1.0,2.0,3.0]]}",))
    monkeypatch.setattr(problem_set, "problems", lambda: (one,))
    status, out, err = cli("problems", "--write")
    assert status == 2 and "none of the controllers that are named ran" in err
    assert f"{one.name}: {one.tried[0]}: - (-)" in out
    assert not own_set.exists()


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
    (["--write", "--controller", "kind = 'h2'"], "takes no --controller"),
])  # fmt: skip
def test_faulty_requests_are_refused(cli: Hil, words: list[str], said: str) -> None:
    status, _, err = cli("problems", *words)
    assert status == 2
    assert said in err
