"""Sweeps over parameters: the points, common seeds, resuming, and what the command writes."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hil
from design.monte_carlo import Workers
from hil.cli import main
from hil.cli.sweep import command
from hil.compose import compose
from hil.errors import HilError
from hil.measure import Quantity
from hil.sweeps import parameters
from hil.sweeps.parameters import load_points, sweep_parameters
from hil.sweeps.points import grid, latin_hypercube
from hil.sweeps.seeds import run_one_by_one, run_seeds
from hil.sweeps.shown import mean_and_interval

HERE = Workers(backend="serial")


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["plant.gain"], "grid 'plant.gain': expected key=a,b,c"),
        (["=1,2"], "grid '=1,2': expected key=a,b,c"),
        (["a=1,,2"], "grid 'a=1,,2': expected key=a,b,c"),
        (["a=1", "a =2"], "grid a: named twice"),
        (["a=25ms,50 ms,25.0 ms"], "grid a: 25 ms, 50 ms, 25.0 ms: 2 of 3 values differ; name each once"),
        (["a=h2,h2"], "grid a: h2, h2: 1 of 2 values differ; name each once"),
        (["a=1,2,3", "b=1,2"], "grid: 6 points; at most 4"),
    ],
)
def test_a_grid_that_is_none_is_refused(asked: list[str], message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.sweeps.points.MOST_POINTS", 4)
    with pytest.raises(HilError, match=message):
        grid(asked)
    assert grid(["a=1,2", "b=1,2"]).values == (("1", "1"), ("1", "2"), ("2", "1"), ("2", "2"))


@pytest.mark.parametrize(
    ("asked", "count", "message"),
    [
        (["a=1:2"], 0, "points: 0; expected 1 to 4"),
        (["a=1:2"], 5, "points: 5; expected 1 to 4"),
        (["a=1"], 2, "range 'a=1': expected key=low:high"),
        (["a=1:2:3"], 2, "range 'a=1:2:3': expected key=low:high"),
        (["a=2:1"], 2, "the lower first, in one unit"),
        (["a=1:1"], 2, "the lower first, in one unit"),
        (["a=1:inf"], 2, "two finite numbers"),
        (["a=1s:2ms"], 2, "in one unit"),
        (["=1:2"], 2, "range '=1:2': the key is missing or repeated"),
        (["a=1:2", "a=1:3"], 2, "range 'a=1:3': the key is missing or repeated"),
    ],
)
def test_a_box_that_is_none_is_refused(asked: list[str], count: int, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.sweeps.points.MOST_POINTS", 4)
    with pytest.raises(HilError, match=message):
        latin_hypercube(asked, count)
    assert len(latin_hypercube(["a=1:2"], 1).values) == 1


@pytest.mark.parametrize("period", ["period=10ms:50ms", "period=10:50ms"])
def test_every_key_takes_one_value_in_each_part_of_its_range(period: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.sweeps.points.MOST_POINTS", 4)
    found = latin_hypercube([period, "plant.gain=100:200"], 4, seed=3)
    assert found.keys == ("period", "plant.gain")
    periods, gains = zip(*found.values)
    assert all(value.endswith(" ms") for value in periods)
    assert sorted(int((float(value.split()[0]) - 10.0) // 10.0) for value in periods) == [0, 1, 2, 3]
    assert sorted(int((float(value) - 100.0) // 25.0) for value in gains) == [0, 1, 2, 3]
    assert found == latin_hypercube([period, "plant.gain=100:200"], 4, seed=3)
    assert found != latin_hypercube([period, "plant.gain=100:200"], 4, seed=4)


def three_seconds(changes: list[str]) -> hil.Experiment:
    return hil.load_experiment("dc-motor-hinf", ["duration=3", *changes])


def test_every_point_has_the_numbers_of_a_sweep_of_its_own() -> None:
    points = grid(["plant.gain=150,170"])
    found = sweep_parameters(load_points(three_seconds, points), points, seeds=range(3), workers=HERE)
    for columns, gain in zip(found.columns, (150, 170)):
        alone = hil.sweep("dc-motor-hinf", runs=3, jobs=1, duration=3, **{"plant.gain": gain})
        assert columns["seed"].tolist() == [0, 1, 2] and np.array_equal(columns["sse"], alone.values["sse"])


def test_a_point_whose_runs_safety_stopped_is_not_the_best() -> None:
    """Its sums are of fewer slots: the sooner it was stopped, the smaller."""
    gains = [[[-0.005]], [[-3.0]]]
    changes = {"duration": 6, "allow_uncertified": True, "limits.state.angle": 3.3}
    found = hil.sweep("dc-motor-local", runs=3, jobs=1, grid={"controller.gain": gains}, **changes)
    calm, stopped = found.columns
    assert stopped["stopped"].all() and not calm["stopped"].any() and stopped["sse"].mean() < calm["sse"].mean()
    assert found.best("sse") == 0 and found.answer("sse").startswith("best point: controller.gain=[[-0.005]]; ")
    assert found.answer("sse").endswith("; 1 point is not judged: safety stopped a run, or a run has no number")
    none = replace(found, columns=[stopped])
    assert none.answer("sse") == "squared tracking error: no point is best; at each safety stopped a run, or a run has no number"
    alone = hil.sweep("dc-motor-local", runs=3, jobs=1, **changes, **{"controller.gain": gains[1]})
    assert "safety stopped 3 of 3 runs; means are over the shorter runs too, whose sums are of fewer slots" in repr(alone)


def test_a_bad_point_is_named_before_anything_runs() -> None:
    with pytest.raises(HilError, match="period=-1: "):
        load_points(three_seconds, grid(["period=0.05,-1"]))


def test_what_was_done_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = grid(["plant.gain=150,170"])

    def sweep() -> parameters.ParameterSweep:
        return sweep_parameters(load_points(three_seconds, points), points, seeds=range(2), workers=HERE, folder=tmp_path)

    first = sweep()
    monkeypatch.setattr("hil.sweeps.seeds.run_seeds", lambda loop, seeds: pytest.fail("ran again"))
    assert np.array_equal(sweep().columns[1]["sse"], first.columns[1]["sse"])


def test_the_command_writes_a_page_and_a_table_loop(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, table = tmp_path / "page.html", tmp_path / "runs.csv"
    arguments = ["sweep", "dc-motor-hinf", "--grid", "plant.gain=150,170", "--grid", "period=25ms,50ms", "--runs", "3"]
    arguments += ["--jobs", "1", "--set", "duration=3", "--set", "allow_uncertified=true", "-o", str(page), "--csv", str(table)]
    with pytest.raises(SystemExit) as end:
        main([*arguments, "--json"])
    out = json.loads(capsys.readouterr().out)
    assert end.value.code in (None, 0) and len(out["points"]) == 4
    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 12 and rows[-1]["period"] == "50 ms" and rows[-1]["seed"] == "2"
    mean = np.mean([float(row["sse"]) for row in rows[-3:]])
    assert out["points"][-1]["metrics"]["sse"]["mean"] == pytest.approx(mean)
    text = page.read_text()
    assert 'class="matrix"' in text and "plant.gain 150" in text and text.startswith("<!doctype html")
    with pytest.raises(SystemExit):
        main([*arguments, "--force"])
    shown = capsys.readouterr().out
    assert f"written: {page}" in shown and "squared tracking error (rad² s)" in shown


def test_a_point_whose_mean_converges_badly_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, arguments = tmp_path / "page.html", ["sweep", "dc-motor-local", "--grid", "controller.gain=[[-0.1]],[[-0.32]]"]
    arguments += ["--runs", "2", "--jobs", "1", "--set", "duration=1", "--set", "allow_uncertified=true", "-o", str(page)]
    with pytest.raises(SystemExit):
        main([*arguments, "--json"])
    quiet, growing = (point["caution"] for point in json.loads(capsys.readouterr().out)["points"])
    assert quiet is None and "converges badly" in growing
    with pytest.raises(SystemExit):
        main(arguments)
    assert "controller.gain=[[-0.32]]: fourth moments" in capsys.readouterr().out
    assert "controller.gain=[[-0.32]]: fourth moments" in page.read_text()


@pytest.mark.parametrize(
    "options, says",
    [
        (["--grid", "period=1,2", "--range", "period=1:2"], "one or the other"),
        (["--range", "plant.gain=1:2"], "belong together"),
        (["--points", "3"], "belong together"),
        (["--grid", "plant.gain=150", "--until", "sse=1"], "--until"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["sweep", "dc-motor-hinf", *options])
    assert end.value.code == 2 and says in capsys.readouterr().err


def test_numbers_of_single_outputs_are_columns_the_same_in_lockstep_and_one_by_one() -> None:
    two = {"kind": "state-space", "A": [[-1.0, 0.0], [1.0, -2.0]], "B": [[1.0], [0.0]], "C": [[1.0, 0.0], [0.0, 1.0]]}
    changes = {"plant": two, "controller": {"kind": "local", "gain": [[-0.2, 0.0]]}, "reference": [], "limits.state": {}}
    experiment = hil.load_experiment("dc-motor-hinf", duration=2, **changes | {"disturbance.0.at": 0.5})
    loop = compose(experiment)
    rows, alone = run_seeds(loop, [0, 1]), run_one_by_one(loop, [0, 1])
    assert {"sse", "sse.y1", "sse.y2", "steady_state_error.y2"} <= set(rows[0]) and "max_abs_u.y1" not in rows[0]
    assert json.dumps(rows, sort_keys=True) == json.dumps(alone, sort_keys=True)  # NaN too
    assert rows[0]["sse"] == pytest.approx(rows[0]["sse.y1"] + rows[0]["sse.y2"])


def test_a_metric_of_ones_own_stands_in_table_store_and_csv(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text("def peak(view): return float(view.tracking()[1].max())\ndef bad(view): return 1 / 0\n")
    monkeypatch.chdir(tmp_path)
    asked = ["dc-motor-hinf", "--runs", "2", "--jobs", "1", "--set", "duration=2", "--grid", "plant.gain=150,170"]
    found = CliRunner().invoke(command, [*asked, "--metric", "mine:peak", "--csv", "a.csv", "--resume", "kept"])
    assert found.exit_code == 0 and found.stderr.count("1 of 2 measures run at once; mine:peak runs alone") == 1
    table = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert len(table) == 4 and all(float(row["peak"]) > 3.0 for row in table)
    assert all('"peak"' in path.read_text() for path in (tmp_path / "kept").iterdir())
    faults = {"mine:bad": "metric bad: ZeroDivisionError", "mine:gone": "has no 'gone'", "peak": "expected module:function"}
    for metric, reported in faults.items():
        failed = CliRunner().invoke(command, [*asked, "--metric", metric])
        assert isinstance(failed.exception, HilError) and reported in str(failed.exception)


def test_paired_differences_tell_points_apart_that_overlap() -> None:
    """Two points that share their seeds: the spread over seeds hides a difference of 0.1, the pairs show it."""
    drawn = 10.0 + np.random.default_rng(0).standard_normal(30)
    noise = 0.01 * np.random.default_rng(1).standard_normal(30)
    columns = tuple({"sse": values, "stopped": np.zeros(30)} for values in (drawn, drawn + 0.1 + noise))
    sse = Quantity(name="sse", title="squared tracking error", better="lower")
    sweep = parameters.ParameterSweep(experiment="motor", points=grid(["period=25ms,50ms"]), columns=columns, quantities=(sse,))
    first, second = sweep.intervals("sse")
    assert first.high > second.low, "the intervals of the points overlap"
    gap = sweep.difference(1, 0, "sse")
    assert gap.low > 0.09 and gap.high < 0.11
    assert sweep.answer("sse").startswith("best point: period=25 ms; ") and "1 of 1 other points differ" in sweep.answer("sse")


def test_a_sentence_writes_every_negative_number_with_one_sign() -> None:
    gap = Quantity(name="gap", title="gap", better="lower")
    said = mean_and_interval(np.array([-2.0, -1.0, -3.0]), gap)
    assert said.startswith("gap -2 on average, 95 % interval -4.48") and said.count("-") == 2 and "−" not in said


def test_the_best_of_equal_points_is_not_better_and_its_interval_holds() -> None:
    """60 sweeps of 20 points of one law. 95 % intervals of each alone: the best's misses in 21, in 55 some point "differs"."""
    sse = Quantity(name="sse", title="squared tracking error", better="lower")
    points, rng, differ, missed = grid([f"period={','.join(f'{ms}ms' for ms in range(1, 21))}"]), np.random.default_rng(0), 0, 0
    for _ in range(60):
        columns = tuple({"sse": 10.0 + rng.standard_normal(50), "stopped": np.zeros(50)} for _ in range(20))
        sweep = parameters.ParameterSweep(experiment="motor", points=points, columns=columns, quantities=(sse,))
        said = sweep.answer("sse")
        low, _, high = said.partition("95 % interval ")[2].partition(";")[0].partition(" to ")
        differ += "; 0 of 19 other points differ" not in said
        missed += not float(low) <= 10.0 <= float(high)
    assert differ <= 11 and missed <= 11  # with 10^-4 more, at 5 % each
