"""``hil reproduce CHAPTER``, whole: verdicts that were checked stay what they are, and the page holds every figure."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from hil.cli.reproduce import command
from hil.thesis import Step, chapters, compute_chapter
from hil.thesis.pages import chapter_page
from tests.hil.thesis.judging import assert_every_number_decides

OK, FALSE, NOT, OPEN = "reproduced", "claim false", "not reproduced", "undecided"
# fmt: off
VERDICTS = {
    "ch2": {
        OK: ("M = 4 yields", "settling time (2.28) of [1, 2]", "in the emulated", "Figure 2.2a: the same", "8.1: control"),
        FALSE: ("Theorem 2.4", "Theorem 2.2", "gains [1, 2] stabilise"),
        NOT: ("settling time (2.28) of (2.27)", "Table 2.1, +-1", "Table 2.1, +-2", "h = 0.8326 halves", "(2.27): the gains"),
        OPEN: ("Table 2.1, +-3", "Figure 2.2a: one run", "computation time"),
    },
    "ch3": {
        OK: ("section 1", "section 2", "gamma = 0.93", "Lemma", "Definition 3.1", "(3.2): longer",
             "3.3.3: two partitions (Corollary 3.2) are less conservative than one (Corollary 3.1), by (3.41)"),
        FALSE: ("gains of section", "Theorem 3.1"), NOT: ("3.4: the gains",), OPEN: ("||z|| / ||w||", "vertical velocity"),
    },
    "ch4": {
        OK: ("u = K(r, h) x with (4.31)", "the partition reduces ||y||", "Remark 4.1", "Remark 4.4", "Remark 4.5", "(4.6)",
             "4.2"),
        FALSE: ("u = K(r, h) x with (4.30)", "Corollary 4.3"), NOT: ("||y|| / ||w||, gains (4.30)", "(4.30): the", "(4.31): the"),
        OPEN: ("Remark 4.6",),
    },
    "ch5": {OK: ("(5.18)", "(5.2): the order", "(5.16) feels", "Theorem 5.1 ", "Theorem 5.1: one P"), FALSE: ("Remark 5.2",)},
    "ch6": {
        OK: ("(6.1)", "(6.2)", "(6.4)", "(6.8)", "Figures 6.5", "Remark 6.1", "Remark 6.2", "6.5: Lambda", "6.6",
             "Figure 6.8: mat", "Figure 6.9", "Figure 6.10"),
        FALSE: ("Theorem 6.1", "(6.11)", "(6.3)", "(6.14)", "(6.17)"),
    },
    "ch7": {
        OK: ("motor: gamma_min is", "motor, H2: the row for d", "(7.41)", "8.2.1", "Remark 7.7: a dynamic"),
        FALSE: ("VTOL: gamma_min is", "VTOL, H2: the row for d"),
        NOT: ("motor: the published gains have the norm gamma_min", "Table 7.2, simulation"),  # 17.4049: a level lies above it
        OPEN: ("motor: time", "Table 7.1, local H2"),
    },
}
"""Begins of items."""
SHOWN = {
    "ch2": "2.2a 2.2b 2.3a 2.3b 2.4a 2.4b", "ch3": "3.2", "ch4": "4.1 4.2 4.3 4.4 4.5 4.6 4.7 4.8", "ch5": "5.3 5.4",
    "ch6": "6.8 6.9 6.10", "ch7": "7.2 7.3 7.4 7.6 7.7 7.8",
}
"""Numbers of figures."""
# fmt: on


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("chapter", chapters())
def test_a_chapter_says_what_it_said(chapter: str) -> None:
    steps: list[Step] = []
    result = compute_chapter(chapter, steps.append)
    for verdict, begins in VERDICTS[chapter].items():
        for begin in begins:
            assert {row.verdict for row in result.rows if row.item.startswith(begin)} == {verdict}, begin
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
