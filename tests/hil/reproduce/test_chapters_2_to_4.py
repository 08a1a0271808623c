"""``hil reproduce ch2|ch3|ch4``: verdicts that were checked stay what they are, and the page holds every figure."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from hil.reproduce import Reproduction, Step, reproduce
from hil.reproduce.chapter2.numbers import _sections
from hil.reproduce.pages import chapter_page
from tests.hil.reproduce.judging import assert_every_number_decides


def verdict(result: Reproduction, start: str) -> str:
    (found,) = [row.verdict for row in result.rows if row.item.startswith(start)]
    return found


def titles(result: Reproduction) -> str:
    return " ".join(panel.title for plot in result.figures for panel in plot.panels)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_chapter_4_says_that_the_published_controller_diverges() -> None:
    steps: list[Step] = []
    result = reproduce("ch4", steps.append)
    assert verdict(result, "u = K(r, h) x with (4.30)") == "claim false"
    assert verdict(result, "u = K(r, h) x with (4.31)") == "reproduced"
    assert verdict(result, "Corollary 4.3") == "claim false"
    assert verdict(result, "||y|| / ||w||, gains (4.30)") == "not reproduced"
    assert verdict(result, "the partition reduces ||y||") == "reproduced"
    assert not any("1.489" in row.printed or "certified)" in row.item for row in result.rows)  # the thesis prints neither
    for number in ("4.1", "4.2", "4.3", "4.8"):
        assert number in titles(result)
    page = chapter_page(result)
    assert "Figures 4.4 and 4.5" in page and "Figures 4.6 and 4.7" in page and page.startswith("<!doctype html>")
    assert json.loads(json.dumps(result.to_json(), allow_nan=False))["counts"]["claim false"] == 3
    assert_every_number_decides(result.rows)
    assert [s.number for s in steps] == sorted(s.number for s in steps) and steps[-1].number == steps[-1].stages
    assert any(s.total and s.done for s in steps)


def test_more_sections_are_feasible_where_fewer_are_not() -> None:
    rows = _sections()
    assert [row.verdict for row in rows] == ["reproduced", "reproduced"]
    assert_every_number_decides(rows)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_chapter_2_tells_what_holds_and_what_does_not() -> None:
    result = reproduce("ch2")
    assert verdict(result, "Theorem 2.4") == "claim false"
    assert verdict(result, "Theorem 2.2") == "claim false"
    assert verdict(result, "settling time (2.28) of (2.27)") == "not reproduced"
    assert verdict(result, "settling time (2.28) of [1, 2]") == "reproduced"
    assert verdict(result, "gains [1, 2] stabilise") == "claim false"
    assert verdict(result, "Table 2.1, +-1 standard deviation, r_0 = 1, as printed") == "not reproduced"
    assert verdict(result, "Table 2.1, +-1 standard deviation, r_0 = 2, not as printed") == "reproduced"
    assert verdict(result, "Figure 2.2a: one run with (2.27)") == "reproduced"
    assert verdict(result, "Figure 2.2a: the same run with [1, 2]") == "reproduced"
    assert any(row.printed == "0.0749 s" for row in result.rows)  # its verdict depends on the machine
    for number in ("2.2a", "2.2b", "2.3a", "2.3b", "2.4a", "2.4b"):
        assert number in titles(result)
    assert_every_number_decides(result.rows)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_chapter_3_tells_which_reading_the_gains_fit() -> None:
    result = reproduce("ch3")
    assert [row.verdict for row in result.rows[:4]] == ["claim false", "reproduced", "claim false", "reproduced"]
    assert verdict(result, "Theorem 3.1") == "claim false"
    assert verdict(result, "gamma = 0.93") == "reproduced"
    ratio = "||z|| / ||w|| in the simulation, if the run lasts"
    assert verdict(result, f"{ratio} 20 s and the noise is held 1 s") == "reproduced"
    assert verdict(result, f"{ratio} 20 s and the noise is held 0.01 s") == "not reproduced"
    assert "3.2" in titles(result)
    assert_every_number_decides(result.rows)


def test_unknown_chapter_is_refused_with_the_known_ones() -> None:
    from hil.cli.reproduce import command

    outcome = CliRunner().invoke(command, ["ch99"])
    assert outcome.exit_code == 2 and "ch2" in outcome.output and "ch4" in outcome.output and "all" in outcome.output
