"""``hil reproduce CHAPTER``, whole: verdicts that were checked stay what they are, and the page holds every figure."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli.reproduce import command
from hil.thesis import Step, chapters, compute_chapter
from hil.thesis.pages import chapter_page
from tests.hil.thesis.judging import assert_every_number_decides
from tests.mutations.faults import ROOT

VERDICTS = Path(ROOT, "tests/data/verdicts.txt").read_text(encoding="utf-8")
FOUND = {part[:3]: part[4:].splitlines() for part in VERDICTS.split("# ")[1:]}
"""Of a chapter: the verdict of every row, but of those that are as good as a fit is."""

SHOWN = {
    "ch2": "2.2a 2.2b 2.3a 2.3b 2.4a 2.4b", "ch3": "3.2", "ch4": "4.1 4.2 4.3 4.4 4.5 4.6 4.7 4.8", "ch5": "5.3 5.4",
    "ch6": "6.8 6.9 6.10", "ch7": "7.2 7.3 7.4 7.6 7.7 7.8",
}  # fmt: skip
"""Numbers of figures."""


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("chapter", chapters())
def test_a_chapter_says_what_it_said(chapter: str) -> None:
    steps: list[Step] = []
    result = compute_chapter(chapter, steps.append)
    rows = [f"{row.verdict}: {row.item}" for row in result.rows]
    assert [row for row in rows if not row.endswith("by a motor fitted to it")] == FOUND[chapter]
    titles = " ".join(each.title for plot in result.figures for each in (plot, *plot.panels))
    assert all(number in titles for number in SHOWN[chapter].split())
    assert chapter_page(result).startswith("<!doctype html>")
    assert sum(json.loads(json.dumps(result.to_json(), allow_nan=False))["counts"].values()) == len(result.rows)
    assert_every_number_decides(result.rows)
    assert [s.number for s in steps] == sorted(s.number for s in steps) and steps[-1].number == steps[-1].stages
    assert any(s.total and s.done for s in steps) or not any(s.total for s in steps)


def test_unknown_chapter_is_refused_with_the_known_ones() -> None:
    outcome = CliRunner().invoke(command, ["ch99"])
    assert outcome.exit_code == 2 and "ch2" in outcome.output and "ch4" in outcome.output and "all" in outcome.output
