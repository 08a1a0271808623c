"""``hil reproduce all``: one page per chapter, an index, one JSON object; and Ctrl-C words on standard error only."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import hil.thesis
from hil.cli.reproduce import command
from hil.pages import Link
from hil.thesis import Reproduction, Step
from hil.thesis.statements import Statement, above, below, equal, judge

MORE = {"ch3": (Statement("one more", "1.00", (equal("x", "x", "1.00"),)), Statement("false", "3", (above("x", "x", 3),)))}


def quick(chapter: str, progress, kept=None) -> Reproduction:
    """A chapter of one row: what the command does with it is under test, not what it computes."""
    progress(Step(stage="first", number=1, stages=2))
    progress(Step(stage="first", number=1, stages=2, text="half", done=1, total=2))
    rows = judge([Statement(f"item of {chapter}", "1", (below("x", "x", 2),)), *MORE.get(chapter, ())], {"x": 1.0})
    return Reproduction(title=f"Title of {chapter} <b>", rows=rows)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(hil.thesis, "compute_chapter", quick)
    return lambda *arguments: CliRunner().invoke(command, [str(a) for a in arguments], catch_exceptions=True)


def test_all_writes_one_page_per_chapter_and_an_index(run, tmp_path: Path) -> None:
    outcome = run("all", "-o", tmp_path / "pages")
    assert outcome.exit_code == 0, outcome.output
    names = {f"{name}.html" for name in hil.thesis.chapters()}
    assert {path.name for path in (tmp_path / "pages").iterdir()} == names | {"index.html"}
    index = (tmp_path / "pages" / "index.html").read_text()
    assert all(f'<a href="{name}">Title of' in index for name in names) and "<b>" not in index.split("<body>")[1][:2000]
    assert run("all", "-o", tmp_path / "pages").exit_code == 0  # pages are replaced


def test_all_refuses_a_file_in_its_place_before_the_work(run, tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("mine")
    outcome = run("all", "-o", tmp_path / "notes")
    assert outcome.exception is not None and "notes" in str(outcome.exception) and (tmp_path / "notes").read_text() == "mine"
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "index.html").write_text("mine")
    outcome = run("all", "-o", tmp_path / "folder")
    assert "is no report" in str(outcome.exception) and len(list((tmp_path / "folder").iterdir())) == 1


def test_all_as_json_is_one_object_by_chapter(run) -> None:
    found = json.loads(run("all", "--json").stdout)
    assert tuple(found) == hil.thesis.chapters()
    one = json.loads(run("ch7", "--json").stdout)
    assert set(one) == {"title", "rows", "counts"} and one["rows"][0]["rule"] == "one-sided: x < 2"


def test_the_index_has_the_counts_and_the_rule_of_every_row(run, tmp_path: Path) -> None:
    run("all", "-o", tmp_path / "pages")
    index = (tmp_path / "pages" / "index.html").read_text()
    for chapter in hil.thesis.chapters():
        assert f"item of {chapter}" in index
    assert "one-sided: x &lt; 2" in index and "half a unit of the last printed digit" in index
    assert "turns 1 of 7 reproduced rows with numbers: 1 of 1 equality, 0 of 0 one run, 0 of 6 one-sided" in index


def test_the_power_of_the_rules_is_said_when_asked(run) -> None:
    assert "turns 1 of 2 reproduced rows" in run("ch3", "--power").stdout and "turns" not in run("ch3").stdout
    assert json.loads(run("ch3", "--power", "--json").stdout)["power"]["equality"] == [1, 1]


def test_a_row_is_shown_in_lines_of_110_columns_under_its_text(run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setitem(MORE, "ch7", [Statement("long", " ".join(100 * "a"), (below("x", "x", 2),))])
    shown = run("ch7").stdout.splitlines()
    at = shown.index("    printed   " + " ".join(48 * "a"))
    assert shown[at + 1 : at + 3] == [14 * " " + " ".join(48 * "a"), 14 * " " + " ".join(4 * "a")]


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_lines_fold_at_the_columns_of_the_terminal(run, monkeypatch: pytest.MonkeyPatch, columns: int) -> None:
    long = " ".join(["word"] * 60)
    said = (Statement(f"long {long}", long, (below(long, "x", 2),), computed=long, basis=long),)
    monkeypatch.setitem(MORE, "ch3", said)
    monkeypatch.setenv("COLUMNS", str(columns))
    text = run("ch3", "--power").stdout
    assert max(map(len, text.splitlines())) <= min(columns, 110) and text.count("word") == 5 * 60


def test_all_ends_with_the_counts_of_all_chapters(run) -> None:
    assert run("all").stdout.endswith("8 rows: 7 reproduced, 1 not reproduced, 0 claim false, 0 undecided\n\n")


def test_progress_is_the_chapter_the_stage_and_its_step(run, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr("hil.cli.terminal.Working.counted", lambda watch, done, total=None, what="": said.append(what))
    assert "first" not in run("ch7", "--json").stdout and said == ["ch7 1/2 first", "ch7 1/2 first: half"]


@pytest.mark.parametrize("href", ["", "http://x", "../x.html", "a/../../x.html", "/x", "a//x", "javascript:alert(1)", "a\\b"])
def test_a_link_leads_to_a_page_beside_it_or_below_only(href: str) -> None:
    with pytest.raises(ValueError, match="href"):
        Link(label="x", href=href)
