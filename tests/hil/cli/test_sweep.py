"""`hil sweep` and `hil compare`: numbers that are never cut, what is said beside them, what is refused before any work."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import NoReturn

import pytest

import hil
from hil.sweeps import seeds
from tests.hil.cli.conftest import Hil

SHORT = ("--jobs", "1", "--set", "duration=4")


def test_json_has_statistics_of_every_metric(cli: Hil) -> None:
    begun = time.perf_counter()
    status, out, _ = cli("sweep", "dc-motor-hinf", "--runs", "3", *SHORT, "--json")
    points = json.loads(cli("sweep", "dc-motor-hinf", "--runs", "2", "--grid", "plant.gain=150,170", *SHORT, "--json")[1])
    found = json.loads(out)
    assert status == 0 and found["runs"] == 3
    assert found["wall_s"] >= 0.0 and points["wall_s"] >= 0.0 and found["wall_s"] + points["wall_s"] < time.perf_counter() - begun
    assert found["metrics"]["sse"]["n"] == 3 and set(found["metrics"]["sse"]["percentiles"]) >= {"5", "50", "95"}


def test_the_length_of_a_run_is_asked_for_as_of_hil_run(cli: Hil) -> None:
    for command in (("sweep", "dc-motor-hinf"), ("compare", "dc-motor-hinf", "dc-motor-h2")):
        lengths = (SHORT[2:], ("--duration", "4 s"))
        asked = [cli(*command, "--runs", "2", "--jobs", "1", "--json", *length)[1] for length in lengths]
        by_set, by_option = (json.loads(out) for out in asked)
        assert by_option["metrics"] == by_set["metrics"] if command[0] == "sweep" else by_option == by_set


@pytest.mark.parametrize("columns", ["40", "80"])
def test_no_number_is_cut_on_a_narrow_terminal(cli: Hil, monkeypatch: pytest.MonkeyPatch, columns: str) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    _, out, _ = cli("sweep", "dc-motor-hinf", "--runs", "3", *SHORT)
    assert "…" not in out and "steady-state" in out
    _, out, _ = cli("compare", "dc-motor-hinf", "dc-motor-h2", "--runs", "2", *SHORT)
    assert "…" not in out and "dc-motor-hinf" in out
    verdict = out.partition("metric,")[0].rstrip().splitlines()
    assert "95 % interval" in " ".join(verdict) and max(map(len, verdict)) <= int(columns)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--runs", "0"], "'--runs': 0 is not a whole number of at least 1"),
        (["--first-seed", "-1"], "'--first-seed': -1"),
        (["--first-seed", "9223372036854775807", "--runs", "2"], "seeds from 0 to 2^63 - 1"),
        (["--jobs", "0"], "jobs: 0"),
        (["--jobs", "-7"], "jobs: -7"),
        (["--jobs", "100000"], "jobs: 100000"),
        (["--until", "sse"], "--until 'sse': expected METRIC=HALFWIDTH, such as sse=0.1"),
        (["--until", "foo=1"], "'foo' is not one of"),
        (["--until", "sse=nan"], "--until"),
        (["--resume", "/dev/zero"], "is no file"),
        (["--resume", "no/where"], "No such file"),
        (["--scheduler", "tcp://127.0.0.1:1"], "--scheduler"),
        (["--set", "plant.gain=nan"], "plant.gain: nan"),
        (["--duration", "2 parsec"], "duration: '2 parsec' is not a duration"),
    ],
)
def test_a_bad_sweep_is_refused_before_it_starts(cli: Hil, arguments: list[str], says: str) -> None:
    status, out, err = cli("sweep", "dc-motor-hinf", *arguments)
    assert (status, out) == (2, "") and says in err


def test_a_grid_that_is_interrupted_says_how_it_goes_on(cli: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ("sweep", "dc-motor-hinf", "--runs", "2", "--grid", "plant.gain=150,170", *SHORT, "--resume", "rows", "--json")
    once = seeds.run_seeds
    with monkeypatch.context() as context:
        context.setattr(seeds, "run_seeds", lambda loop, some: once(loop, some) if loop.experiment.plant.gain == 150 else ended())
        status, out, err = cli(*arguments)
    assert status == 130 and err == "hil: interrupted; the same command goes on from rows\n"
    assert len(json.loads(out)["points"]) == 1
    status, out, _ = cli(*arguments)
    assert status == 0 and len(json.loads(out)["points"]) == 2


def test_a_sweep_that_is_interrupted_before_its_first_run_shows_no_empty_table(
    cli: Hil, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(seeds, "run_seeds", lambda *_: ended())
    status, out, err = cli("sweep", "dc-motor-hinf", "--runs", "2", *SHORT)
    assert status == 130 and err == "hil: interrupted; --resume FILE would keep what is finished\n"
    assert out.endswith("no run ended, so there is nothing to show\n") and "metric" not in out
    status, _, err = cli("sweep", "dc-motor-hinf", "--runs", "2", "--grid", "plant.gain=150,170", *SHORT)
    assert status == 130 and "--resume FOLDER would keep" in err


def ended() -> NoReturn:
    raise KeyboardInterrupt


def test_a_sweep_keeps_its_rows_and_refuses_those_of_another(cli: Hil, tmp_path: Path) -> None:
    assert cli("sweep", "dc-motor-hinf", "--runs", "2", *SHORT, "--resume", "rows")[0] == 0
    assert len((tmp_path / "rows").read_text().splitlines()) == 3
    status, _, err = cli("sweep", "dc-motor-h2", "--runs", "2", *SHORT, "--resume", "rows")
    assert status == 2 and "rows holds runs of 'dc-motor-hinf'" in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["dc-motor-hinf", "nosuch"], "no experiment 'nosuch'"),
        (["dc-motor-h2", "dc-motor-hinf", "dc-motor-hinf"], "'dc-motor-hinf' is named twice"),
        (["dc-motor-hinf"], "only 'dc-motor-hinf' is named; expected two or more, of one: hil sweep dc-motor-hinf"),
        (["dc-motor-hinf", "omni-1khz", "--runs", "2"], "dc-motor-hinf, omni-1khz: no number that all have in one unit"),
        (["dc-motor-hinf", "dc-motor-h2", "--runs", "1"], "'--runs': 1"),
        (["dc-motor-hinf", "dc-motor-h2", "--jobs", "0"], "jobs: 0"),
        (["dc-motor-hinf", "dc-motor-h2", "-o", "."], "is a folder"),
        (["dc-motor-hinf", "dc-motor-h2", "--set", "plant.gian=1"], "plant.gian: unknown field"),
        (["dc-motor-hinf", "dc-motor-h2", "--runs", "100000", "-o", "no/x.html"], "no folder no"),
    ],
)
def test_a_bad_comparison_is_refused_before_it_starts(cli: Hil, arguments: list[str], says: str) -> None:
    status, out, err = cli("compare", *arguments)
    assert (status, out) == (2, "") and says in err


def test_compare_writes_a_page_and_paired_differences(cli: Hil, tmp_path: Path) -> None:
    arguments = ("dc-motor-hinf", "dc-motor-h2", "--runs", "2", *SHORT, "-o", "page.html", "--json")
    status, out, _ = cli("compare", *arguments)
    found = json.loads(out)["experiments"]["dc-motor-h2"]
    assert status == 0 and found["difference"]["sse"]["mean"] is not None
    assert found["metrics"]["sse_after_5s"]["mean"] is None  # SHORT ends before
    assert "<html" in (tmp_path / "page.html").read_text()


def test_the_table_of_a_sweep_fits_eighty_columns(cli: Hil) -> None:
    out = cli("sweep", "dc-motor-hinf", "--runs", "3", "--jobs", "1", "--set", "duration=2")[1]
    assert "steady-state" in out and max(map(len, out.splitlines())) <= 80


def test_the_table_of_a_comparison_fits_eighty_columns_and_counts_its_runs(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    names = ("dc-motor-ours-two-samples", "dc-motor-ours-h2", "dc-motor-local")
    out = cli("compare", *names, "--runs", "7", "--jobs", "1", "--duration", "10")[1]
    lines = out.splitlines()
    assert max(map(len, lines)) <= 80
    said = " ".join(out.split())
    assert "dc-motor-local is worse: safety stopped 7 of its 7 runs, none of dc-motor-ours-two-samples" in said
    local = [line.split() for line in lines if line.strip().startswith("dc-motor-local")]
    assert ["dc-motor-local", "7"] in [words[:2] for words in local]  # the input is there in every run,
    assert ["dc-motor-local", "0", *"–––"] in local  # but none has settled


def test_a_number_that_no_run_has_is_said_and_takes_no_row(cli: Hil) -> None:
    for command in (("sweep", "dc-motor-hinf", "--runs", "3"), ("compare", "dc-motor-hinf", "dc-motor-h2", "--runs", "2")):
        out = " ".join(cli(*command, *SHORT)[1].split())
        assert out.count("squared error after 5 s") == 1 and "no run has a number for: squared error after 5 s" in out


def test_a_sweep_over_points_says_which_is_the_best(cli: Hil) -> None:
    out = " ".join(cli("sweep", "dc-motor-hinf", "--grid", "plant.gain=100,170", "--runs", "3", *SHORT)[1].split())
    assert "best point: plant.gain=" in out


@pytest.mark.parametrize("points", [(), ("--grid", "plant.gain=170,172.38")])
def test_runs_with_other_gains_in_the_file_that_is_named_are_not_gone_on_with(
    cli: Hil, monkeypatch: pytest.MonkeyPatch, points: tuple[str, ...]
) -> None:  # fmt: skip
    text = cli("show", "dc-motor-hinf")[1].replace('kind = "hinf"', 'kind = "designed"\nfile = "gains.json"')
    Path("mine.toml").write_text(text)
    for R, expected in ((0.01, 0), (0.01, 0), (0.5, 2)):
        hil.design("dc-motor", information="constant", starts=1, R=R).save("gains.json", force=True)
        monkeypatch.setattr("tests.hil.cli.conftest.COMPOSED", {})
        status, _, err = cli("sweep", "mine.toml", "--runs", "2", *SHORT, "--resume", "kept", *points)
        assert status == expected, err
    assert "holds runs of 'dc-motor-hinf' with another digest" in " ".join(err.split())
