"""``hil reproduce ch2|ch3|ch4``: verdicts that were checked stay what they are, and the page holds every figure."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from hil.reproduce import Reproduction, reproduce


def verdict(result: Reproduction, start: str) -> str:
    (found,) = [row.verdict for row in result.rows if row.item.startswith(start)]
    return found


def titles(result: Reproduction) -> str:
    return " ".join(panel.title for plot in result.figures for panel in plot.panels)


def test_chapter_4_says_that_the_published_controller_diverges() -> None:
    result = reproduce("ch4")
    assert verdict(result, "u = K(r, h) x with (4.30)") == "claim false"
    assert verdict(result, "u = K(r, h) x with (4.31)") == "reproduced"
    assert verdict(result, "Corollary 4.3") == "claim false"
    assert verdict(result, "||y|| / ||w||, gains (4.30)") == "not reproduced"
    assert verdict(result, "quotient") == "reproduced"
    for number in ("4.1", "4.2", "4.3", "4.8"):
        assert number in titles(result)
    page = result.page()
    assert "Figures 4.4 and 4.5" in page and "Figures 4.6 and 4.7" in page and page.startswith("<!doctype html>")
    assert json.loads(json.dumps(result.to_json()))["counts"]["claim false"] >= 4


@pytest.mark.slow
def test_chapter_2_tells_what_holds_and_what_does_not() -> None:
    result = reproduce("ch2")
    assert verdict(result, "Theorem 2.4") == "claim false"
    assert verdict(result, "Theorem 2.2") == "claim false"
    assert verdict(result, "settling time (2.28) of (2.27)") == "not reproduced"
    assert verdict(result, "settling time (2.28) of [1, 2]") == "reproduced"
    assert verdict(result, "gains [1, 2] stabilise") == "claim false"
    for number in ("2.2a", "2.2b", "2.3a", "2.3b", "2.4a", "2.4b"):
        assert number in titles(result)


@pytest.mark.slow
def test_chapter_3_tells_which_reading_the_gains_fit() -> None:
    result = reproduce("ch3")
    assert [row.verdict for row in result.rows[:4]] == ["claim false", "reproduced", "claim false", "reproduced"]
    assert verdict(result, "Theorem 3.1") == "claim false"
    assert verdict(result, "gamma = 0.93") == "reproduced"
    assert "3.2" in titles(result)


def test_unknown_chapter_is_refused_with_the_known_ones() -> None:
    from hil.cli.reproduce import command

    outcome = CliRunner().invoke(command, ["ch99"])
    assert outcome.exit_code == 2 and "ch2" in outcome.output and "ch4" in outcome.output
