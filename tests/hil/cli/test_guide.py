"""`hil guide`: topics, a page, a topic that is not there; `hil licences`: what is installed, and what its licence asks."""

from __future__ import annotations

import json
import re
import sys
from importlib.metadata import distributions
from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli import main
from hil.cli.guide import _show_licences, pages
from hil.cli.guide import guide as command
from tests.bench.catalogue import PARTS
from tests.bench.page import page_of
from tests.hil.cli.conftest import Hil


def test_without_a_topic_it_lists_every_page_with_its_title() -> None:
    lines = CliRunner().invoke(command, []).stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(pages()) and lines[0].endswith("Quick start")


@pytest.mark.parametrize("topic", list(pages()))
def test_a_page_is_printed_as_it_stands_where_it_is_piped(topic: str) -> None:
    assert CliRunner().invoke(command, [topic]).stdout == pages()[topic].read_text(encoding="utf-8")


def test_a_page_goes_nowhere_where_standard_output_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert command.callback is not None
    command.callback("figures")


@pytest.mark.parametrize("topic", list(pages()))
def test_a_page_uses_the_words_of_the_glossary(topic: str) -> None:
    """Whoever is meant has a name there: rig, controller, node, program, user."""
    text = re.sub(r"`[^`]*`|```.*?```", "", pages()[topic].read_text(encoding="utf-8"), flags=re.S)
    unsaid = r"\b(?:nobody|somebody|anybody|everybody|strangers?|told|heard|hears|doors?|talkers?|spoke|speaks)\b"
    assert not re.findall(unsaid, text, re.I)
    depths = [len(marks) for marks in re.findall(r"^(#+) ", text, re.M)]
    assert depths[0] == 1 and all(below <= above + 1 for above, below in pairwise(depths)), "make docs refuses the page"


def test_the_page_of_figures_is_made_of_what_was_measured() -> None:
    if (page := pages().get("figures")) is None:
        pytest.skip("no figures were measured for the guide: make figures")
    machines = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(page.parent.glob("figures-*.json"))]
    assert page.read_text(encoding="utf-8") == page_of(machines)
    assert not any(found["quick"] for found in machines)
    names = [figure.name for part in PARTS for figure in part.figures]
    for found in machines:  # one of an earlier day may lack what came since
        measured = [row["name"] for row in found["figures"]]
        assert measured == [name for name in names if name in measured]


def test_an_unknown_topic_is_refused_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["guide", "real-tmie"])
    assert end.value.code == 2 and "did you mean 'real-time'?" in capsys.readouterr().err


def test_a_part_of_one_name_is_enough_and_of_several_is_refused_with_them(capsys: pytest.CaptureFixture[str]) -> None:
    for part, title in (("designs", "# Designs and certificates\n"), ("CI", "# In continuous integration\n")):
        assert CliRunner().invoke(command, [part]).stdout.startswith(title)
    with pytest.raises(SystemExit) as end:
        main(["guide", "can"])
    assert end.value.code == 2 and "it stands in the names vcan, can-bus;" in capsys.readouterr().err


def test_a_word_that_is_no_topic_is_answered_with_the_pages_that_speak_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["guide", "sae"])
    assert end.value.code == 2 and "it stands in: can-bus; `hil guide` lists them" in capsys.readouterr().err


def test_the_controller_of_the_wire_format_is_the_one_that_is_tested() -> None:
    program, _ = re.findall(r"```python\n(.*?)```", pages()["wire-format"].read_text(encoding="utf-8"), re.S)
    tested = (Path(__file__).parents[2] / "foreign_controller.py").read_text(encoding="utf-8")
    assert tested.split('"""\n\n', 1)[1] == program


def test_every_installed_package_is_listed_with_its_licence(
    cli: Hil, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = cli("licences", "--json")
    rows = {row["name"]: row for row in json.loads(out)["packages"]}
    assert status == 0 and len(rows) >= len({d.metadata["Name"] for d in distributions()}) - 1
    assert "LGPL" in rows["python-can"]["licence"] or "Lesser" in rows["python-can"]["licence"]
    assert rows["python-can"]["copyleft"] and rows["python-can"]["needed_by_hil"]
    assert not rows["numpy"]["copyleft"] and rows["numpy"]["needed_by_hil"] and not rows["pytest"]["needed_by_hil"]
    _show_licences([*rows.values()])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("! ") and max(map(len, lines)) <= 80
