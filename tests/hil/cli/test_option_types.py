"""One option, one meaning, in all commands, of times too; and what `hil list` and `hil sweep` say of themselves."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest

from hil.cli import COMMANDS, command_of
from hil.cli.option_types import Duration, NumberList
from hil.experiment import FIRST
from tests.hil.cli.conftest import Hil


def commands(group: click.Command, path: str) -> Iterator[tuple[str, click.Command]]:
    yield path, group
    for name, command in getattr(group, "commands", {}).items():
        yield from commands(command, f"{path} {name}")


def options() -> Iterator[tuple[str, click.Option]]:
    for name in COMMANDS:
        top: Any = command_of(name)
        for path, command in commands(top, name):
            yield from ((path, p) for p in command.params if isinstance(p, click.Option))


def said(option: click.Option) -> str:
    return option.help or ""


def test_an_option_of_one_name_means_one_thing_in_all_commands() -> None:
    seen = list(options())
    assert len(seen) > 100
    for path, option in seen:
        names = set(option.opts)
        if "-o" in names:
            assert "--output" in names, f"{path}: -o is --output everywhere"
        if "--output" in names:
            assert "-o" in names and isinstance(option.type, click.Path), f"{path}: --output is a file or folder to write"
        if "--force" in names:
            assert option.is_flag and said(option).startswith("Replace "), f"{path}: --force replaces what is there"
        if "--json" in names:
            assert option.is_flag and said(option).startswith("Print "), f"{path}: --json prints"
        if "--csv" in names:
            assert isinstance(option.type, click.Path) and said(option).startswith("Write "), f"{path}: --csv writes a file"
        if "--set" in names:
            assert option.metavar == "PATH=VALUE" and said(option).startswith("Change a field"), f"{path}: --set changes a field"


def test_no_help_says_a_range_beyond_every_use() -> None:
    for path, option in options():
        context = click.Context(click.Command(path))
        record = option.get_help_record(context)
        assert record is None or "e+30" not in record[1], path


@pytest.mark.parametrize(("text", "said"), [("1e31", "from -1e+30 to 1e+30"), ("x", "is not a number")])
def test_a_number_is_finite_all_the_same(text: str, said: str, cli: Hil) -> None:
    status, _, err = cli("design", "dc-motor", "--gain-bound", text)
    assert status == 2 and said in err


def test_the_list_begins_with_what_to_try_and_has_groups_of_one_line_each(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = cli("list")[1].splitlines()
    assert lines[0].startswith(f"to begin with: hil run {FIRST}") and max(map(len, lines)) <= 80
    heads = [line for line in lines if line.startswith("experiments with the plant ")]
    found = json.loads(cli("list", "--json")[1])
    assert len(heads) == len(set(found["plants"].values())) > 4
    first = lines.index(heads[0])
    assert lines[first + 1].split()[0] == FIRST
    named = [line.split()[0] for line in lines if line.startswith("  ")]
    assert all(named.count(name) == 1 for name in found["experiments"])


def test_a_sweep_says_units_and_writes_a_row_per_run(cli: Hil, tmp_path: Path) -> None:
    table = tmp_path / "runs.csv"
    arguments = ("sweep", "dc-motor-hinf", "--runs", "3", "--jobs", "1", "--duration", "2s", "--csv", str(table))
    status, out, _ = cli(*arguments)
    assert status == 0 and "squared tracking error (rad² s)" in out and "overshoot (%)" in out
    rows = list(csv.DictReader(table.open()))
    assert [row["seed"] for row in rows] == ["0", "1", "2"] and all(float(row["sse"]) > 0 for row in rows)
    status, _, err = cli(*arguments)
    assert status == 2 and "add --force" in err
    assert cli(*arguments, "--force")[0] == 0


def test_people_read_titles_and_programs_read_keys(cli: Hil, tmp_path: Path) -> None:
    """A number has one title in every table, tile and page, and one key in JSON and CSV."""
    short = ("--duration", "2s")
    summary = json.loads(cli("run", "dc-motor-hinf", *short, "--json", "-o", str(tmp_path / "run.mcap"))[1])
    assert summary["titles"].keys() == summary["metrics"].keys() == summary["units"].keys()
    page = tmp_path / "all.html"
    many = ("--runs", "2", "--jobs", "1", *short)
    read = [
        cli("run", "dc-motor-hinf", *short, "-o", str(tmp_path / "again.mcap"))[1],
        cli("sweep", "dc-motor-hinf", *many)[1],
        cli("sweep", "dc-motor-hinf", "--grid", "plant.gain=140,150", *many)[1],
        cli("compare", "dc-motor-hinf", "dc-motor-h2", *many, "-o", str(page))[1],
        page.read_text(),
    ]
    assert f"written: {page}\n" in read[3]
    for text in read:
        words = " ".join(text.split())
        assert "squared tracking error" in words and "steady-state" in words
        assert not re.search(r"\bsse\b|steady_state_error|max_abs_u", words)


TIMES = {"--duration", "--for", "--wait", "--timeout", "--period"}


TEXT = tuple(f"{name} --duration" for name in ("run", "rig", "live", "sweep", "compare"))


def test_every_time_is_a_duration() -> None:
    """`--duration` of run, rig, live, sweep and compare is text, for it goes to the experiment, which reads it the same way."""
    for path, option in options():
        for at in (f"{path} {name}" for name in option.opts if name in TIMES):
            if at != "new --for":  # an experiment
                times = option.type._number.__name__ == "in_seconds" if isinstance(option.type, NumberList) else None
                assert isinstance(option.type, Duration) or times or at in TEXT, at


@pytest.mark.parametrize("duration", ["1s", "1000ms", "1 s", "1.", "1e3ms"])
def test_a_run_lasts_as_long_as_is_typed(cli: Hil, duration: str) -> None:
    status, out, err = cli("run", "dc-motor-hinf", "--duration", duration, "--set", "period=25ms", "--quiet", "-o", "a.mcap")
    assert (status, err) == (0, "") and "40" in out


@pytest.mark.parametrize(
    ("value", "says"),
    [("2 parsec", "'2 parsec' is not a duration"), ("0s", "a duration above 0 s"), ("-1s", "above 0 s"), ("1e999", "inf")],
)
def test_an_option_says_what_is_no_duration(value: str, says: str) -> None:
    with pytest.raises(click.BadParameter, match=says):
        Duration(above=True).convert(value, None, None)


def test_lists_of_times_have_units_too() -> None:
    assert NumberList(above=True, times=True).convert("1ms,0.05,2 s", None, None) == (0.001, 0.05, 2.0)
