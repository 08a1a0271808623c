"""Pictures of numbers: what is drawn lies in its box, and fills it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hil.pages.html.figures import BarGroup, Bars, Histogram, Marker, Scene, Shape
from hil.pages.html.svg import draw_bars, draw_histogram, draw_scene, nice_ticks

PICTURES = {
    "bars": draw_bars(Bars(title="delays", categories=("0", "1"), groups=(BarGroup(label="sc", values=np.array([3.0, 1.0])),))),
    "histogram": draw_histogram(Histogram(title="lateness", edges=np.arange(4.0), counts=np.array([1.0, 5.0, 2.0]))),
}


MARKS = tuple(Marker(x=x, label=f"mark {x:g}", state="bad") for x in (2.0, 2.05, 2.1, 7.9, 8.0))
EDGES, COUNTS = np.array([1.0, 2.0, 4.0, 8.0]), np.array([3.0, 0.0, 40.0])
SQUARE = Shape(points=[(-1.0, 0.0), (3.0, 0.0), (3.0, 2.0), (np.nan, np.nan), (-1.0, 2.0)], label="way")
FULL = PICTURES | {
    "whiskers": draw_bars(Bars(
        title="d", categories=("a", "b", "c"), x_label="node", y_label="delay", y_unit="ms",
        groups=(BarGroup(label="sc", values=np.array([3.0, 1.0, 2.0]), whiskers=[(2.0, 4.0), (0.5, 1.5), (-1.0, 5.0)]),
                BarGroup(label="ca", values=np.array([1.0, np.nan, 4.0]), hollow=True)),
    )),
    "marks": draw_histogram(
        Histogram(title="l", edges=EDGES, counts=COUNTS, x_label="late", x_unit="us", y_label="n", markers=MARKS)
    ),
    "log marks": draw_histogram(Histogram(title="l", edges=EDGES, counts=COUNTS, x_log=True, y_log=True, markers=MARKS)),
    "decades": draw_histogram(Histogram(title="l", edges=np.geomspace(0.5, 2e4, 4), counts=COUNTS, x_log=True)),
    "scene": draw_scene(Scene(title="s", shapes=(SQUARE,), x_label="x", y_label="y", axes=True)),
    "flat scene": draw_scene(Scene(title="s", shapes=(SQUARE,), labels=((-1.0, 0.0, "west"), (3.0, 2.0, "east")), axes=False)),
}  # fmt: skip


def words(svg: str) -> list[tuple[str, float, float, float, str]]:
    """Class, left, right and baseline of each text that stands upright, letters of 5.5 px, and the text."""
    found = []
    level = re.sub(r'<g transform="[^"]*">.*?</g>', "", svg)
    for kind, x, y, anchor, text in re.findall(r'<text class="([^"]*)" x="(\S+)" y="(\S+)" text-anchor="(\w+)">([^<]*)<', level):
        width = 5.5 * len(text)
        left = float(x) - {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor] * width
        found.append((kind, left, left + width, float(y), text))
    return found


@pytest.mark.parametrize("name", FULL)
def test_words_and_lines_stay_in_their_picture_and_no_word_lies_on_another(name: str) -> None:
    svg = FULL[name]
    width, height = map(float, re.findall(r'viewBox="0 0 (\d+) (\d+)"', svg)[0])
    found = words(svg)
    for _, left, right, y, text in found:
        assert left >= -1.0 and right <= width + 1.0 and 8.0 <= y <= height - 2.0, text
    for i, (_, left, right, y, text) in enumerate(found):
        for _, other, end, z, said in found[:i]:
            assert abs(y - z) >= 8.0 or right <= other or end <= left, (text, said)
    for drawn in re.findall(r' d="([^"]*)"', svg):
        for x, y in re.findall(r"[ML](\S+?) ([\d.-]+)", drawn):
            assert 0.0 <= float(x) <= width and 0.0 <= float(y) <= height, drawn
    upright = r'<g transform="translate\((\S+) (\S+)\) rotate\(-90\)"><text class="axis-label" x="0.0" y="0.0"'
    up = re.findall(upright, svg)
    assert len(up) == 1 or name == "flat scene"
    assert all(8.0 <= float(x) <= 20.0 and 0.3 * height < float(y) < 0.7 * height for x, y in up)


@pytest.mark.parametrize(
    ("low", "high", "wanted", "ticks"),
    [
        (0.0, 1.0, 5, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]), (0.0, 4.2, 5, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]),
        (-3.0, 7.0, 4, [-5.0, -2.5, 0.0, 2.5, 5.0, 7.5]), (0.0, 30.0, 5, [0.0, 10.0, 20.0, 30.0]), (2.0, 2.0, 5, [2.0]),
    ],
)  # fmt: skip
def test_ticks_enclose_a_range_in_round_steps(low: float, high: float, wanted: int, ticks: list[float]) -> None:
    assert nice_ticks(low, high, wanted) == pytest.approx(ticks)
