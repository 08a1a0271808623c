"""Pictures of numbers: what is drawn lies in its box, and fills it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hil.pages.html.figures import BarGroup, Bars, Histogram, Marker, Scene, Shape
from hil.pages.html.svg import draw_bars, draw_histogram, draw_scene

PICTURES = {
    "bars": draw_bars(Bars(title="delays", categories=("0", "1"), groups=(BarGroup(label="sc", values=np.array([3.0, 1.0])),))),
    "histogram": draw_histogram(Histogram(title="lateness", edges=np.arange(4.0), counts=np.array([1.0, 5.0, 2.0]))),
}


@pytest.mark.parametrize("svg", PICTURES.values(), ids=PICTURES)
def test_what_is_drawn_fills_a_box_of_560_by_250(svg: str) -> None:
    assert re.findall(r'viewBox="([^"]*)"', svg) == ["0 0 560 250"]
    (left, y, right) = map(float, re.findall(r'class="axis" d="M(\S+) (\S+)H(\S+)"', svg)[0])
    assert (left, right) == (58.0, 548.0) and 200.0 < y < 234.0, "there is room for numbers left and below"


def tops(svg: str) -> list[float]:
    return [float(y) for y in re.findall(r'<rect[^>]* y="([\d.]+)"', svg)]


def test_counts_on_a_logarithmic_axis_rise_by_equal_steps_for_equal_factors() -> None:
    one, ten, hundred = tops(
        draw_histogram(Histogram(title="n", edges=np.arange(4.0), counts=np.array([1.0, 10.0, 100.0]), y_log=True))
    )
    assert one - ten == pytest.approx(ten - hundred, abs=0.2) and one - ten > 30.0
    linear = tops(draw_histogram(Histogram(title="n", edges=np.arange(4.0), counts=np.array([1.0, 2.0, 3.0]))))
    assert linear[0] - linear[1] == pytest.approx(linear[1] - linear[2], abs=0.2)


def test_bars_without_a_number_stand_on_an_axis_from_0_to_1() -> None:
    svg = draw_bars(Bars(title="delays", categories=("0", "1"), groups=(BarGroup(label="sc", values=np.full(2, np.nan)),)))
    numbers = [float(text) for text in re.findall(r'text-anchor="end"[^>]*>([\d.]+)<', svg)]
    assert (min(numbers), max(numbers)) == (0.0, 1.0) and not tops(svg)


def test_words_of_a_scene_stay_inside_and_shapes_have_the_ink_of_their_number() -> None:
    way = Shape(points=[(0.0, 0.0), (4.0, 1.0)])
    patch = Shape(points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], colour=2, filled=True)
    svg = draw_scene(Scene(title="s", shapes=(way, patch), labels=((0.0, 0.5, "west"), (2.0, 0.5, "amid"), (4.0, 0.5, "east"))))
    anchors = dict(re.findall(r'text-anchor="(\w+)"[^>]*>(west|amid|east)<', svg))
    assert {anchors[anchor]: anchor for anchor in anchors} == {"west": "start", "amid": "middle", "east": "end"}
    assert "stroke:var(--text)" in svg and "fill:var(--c2)" in svg


@pytest.mark.parametrize("x_log", [False, True])
def test_a_mark_is_a_line_at_its_number_and_its_words_stay_inside(x_log: bool) -> None:
    marks = tuple(Marker(x=x, label=f"mark {x:g}", state=state) for x, state in ((1.0, "bad"), (4.0, "good"), (9.0, "bad")))
    histogram = Histogram(title="n", edges=np.array([1.0, 2.0, 4.0, 8.0]), counts=np.ones(3), x_log=x_log, markers=marks)
    svg = draw_histogram(histogram)
    states, at = zip(*re.findall(r'class="mark mark-(\w+)" d="M([\d.]+) ', svg))
    share = 2.0 / 3.0 if x_log else 3.0 / 7.0
    assert states == ("bad", "good"), "a mark beyond the edges is left out"
    assert [float(x) for x in at] == pytest.approx([58.0, 58.0 + share * (548.0 - 58.0)], abs=0.1)
    assert "mark 1<" in svg and "mark 4<" in svg and "mark 9" not in svg
