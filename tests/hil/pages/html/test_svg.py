"""Pictures of numbers: what is drawn lies in its box, and fills it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hil.pages import BarGroup, Bars, Histogram, Marker, Scene, Shape
from hil.pages.html.svg import draw_bars, draw_histogram, draw_scene, nice_ticks, scene_legend

PICTURES = {
    "bars": draw_bars(Bars(title="delays", categories=("0", "1"), groups=(BarGroup(label="sc", values=np.array([3.0, 1.0])),))),
    "histogram": draw_histogram(Histogram(title="lateness", edges=np.arange(4.0), counts=np.array([1.0, 5.0, 2.0]))),
}


@pytest.mark.parametrize("svg", PICTURES.values(), ids=PICTURES)
def test_what_is_drawn_fills_a_box_of_560_by_250(svg: str) -> None:
    assert re.findall(r'viewBox="([^"]*)"', svg) == ["0 0 560 250"]
    (left, y, right) = map(float, re.findall(r'class="axis" d="M(\S+) (\S+)H(\S+)"', svg)[0])
    assert (left, right) == (58.0, 548.0) and 200.0 < y < 234.0, "there is room for numbers left and below"


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


def ticks(svg: str, anchor: str) -> list[tuple[float, float, str]]:
    """Place and words of each tick below ("middle") or left ("end") of what is drawn."""
    found = re.findall(rf'<text class="tick" x="(\S+)" y="(\S+)" text-anchor="{anchor}">([^<]*)</text>', svg)
    return [(float(x), float(y), text) for x, y, text in found]


def test_a_tick_stands_at_its_number_with_a_line_through_the_picture_and_an_axis_says_what_it_counts() -> None:
    svg = FULL["marks"]  # counts to 40, from 1 to 8 us
    below, beside = ticks(svg, "middle"), ticks(svg, "end")
    assert [text for *_, text in below] == ["2", "4", "6", "8"] and [text for *_, text in beside] == ["0", "10", "20", "30", "40"]
    assert [x for x, *_ in below] == pytest.approx([58.0 + (v - 1.0) / 7.0 * 490.0 for v in (2, 4, 6, 8)], abs=0.1)
    levels = [206.0 - v / 40.0 * 188.0 for v in (0, 10, 20, 30, 40)]
    assert [y - 4.0 for _, y, _ in beside] == pytest.approx(levels, abs=0.1)
    lines = re.findall(r'class="grid" d="M(\S+) (\S+)H(\S+)"', svg)
    assert [float(y) for _, y, _ in lines] == pytest.approx(levels, abs=0.1)
    assert {(x, end) for x, _, end in lines} == {("58", "548")}
    assert '<text class="axis-label" x="303.0" y="244.0" text-anchor="middle">late (us)</text>' in svg
    assert "translate(13 112)" in svg and ">n</text></g>" in svg and ">delay (ms)</text></g>" in FULL["whiskers"]


@pytest.mark.parametrize(
    ("low", "high", "counts", "below", "beside"),
    [
        (1.0, 8.0, [3.0], "1 2 5", "1 10"), (0.5, 2e4, [40.0], "1 10 100 1000 10000", "1 10 100"),
        (3.0, 400.0, [1.0], "5 10 20 50 100 200", "1 10"),
    ],
)  # fmt: skip
def test_few_decades_have_ticks_between_them(low: float, high: float, counts: list[float], below: str, beside: str) -> None:
    svg = draw_histogram(Histogram(title="l", edges=np.array([low, high]), counts=np.array(counts), x_log=True, y_log=True))
    plain = [text.replace("\u2009", "").replace(" ", "") for *_, text in ticks(svg, "middle")]
    assert [float(text) for text in plain] == [float(text) for text in below.split()]
    assert [float(text) for *_, text in ticks(svg, "end")] == [float(text) for text in beside.split()]


def test_words_of_a_mark_stand_beside_it_and_of_a_picture_in_its_label() -> None:
    svg = FULL["marks"]
    lines = [float(x) for x in re.findall(r'class="mark mark-bad" d="M(\S+) ', svg)]
    places = re.findall(r'<text class="mark-label" x="(\S+)" y="(\S+)" text-anchor="(\w+)">', svg)
    for line, (x, _, anchor) in zip(lines, places):
        assert float(x) - line == pytest.approx(4.0 if anchor == "start" else -4.0, abs=0.1)
    assert [anchor for *_, anchor in places] == ["start"] * 3 + ["end"] * 2
    assert len({y for _, y, _ in places[:3]}) == 3 and float(places[0][1]) < float(places[1][1])
    assert 'aria-label="&quot;a&quot; &lt;b&gt;"' in draw_histogram(Histogram(title='"a" <b>', edges=EDGES, counts=COUNTS))


@pytest.mark.parametrize(("names", "kind"), [(("abcdef",) * 4, "few"), (("a",) * 5, "many"), (("abcdefg",), "many")])
def test_few_short_names_are_drawn_for_a_telephone_too(names: tuple[str, ...], kind: str) -> None:
    svg = draw_bars(Bars(title="d", categories=names, groups=(BarGroup(label="n", values=np.zeros(len(names))),)))
    assert svg.startswith(f'<svg class="{kind}"')
    slot = (548.0 - 58.0) / len(names)
    assert [x for x, *_ in ticks(svg, "middle")] == pytest.approx([58.0 + (i + 0.5) * slot for i in range(len(names))], abs=0.1)
    bars = [(float(x), float(width)) for x, width in re.findall(r'<rect class="bar c0" x="(\S+)" y="\S+" width="(\S+)"', svg)]
    assert [x + width / 2.0 for x, width in bars] == pytest.approx([x for x, *_ in ticks(svg, "middle")], abs=0.1)
    assert [text for *_, text in ticks(svg, "end")][-1] == "1", "bars of 0 stand on an axis to 1"


def test_bars_stand_side_by_side_on_the_axis_and_a_whisker_spans_its_interval_over_the_middle_of_its_bar() -> None:
    numbers = re.findall(r'<rect class="bar[^>]*x="(\S+)" y="(\S+)" width="(\S+)" height="(\S+)"', FULL["whiskers"])
    bars = [tuple(map(float, each)) for each in numbers]
    assert len(bars) == 5 and all(y + height == pytest.approx(206.0, abs=0.2) for _, y, _, height in bars)
    first, second = bars[0], bars[1]
    assert first[3] / second[3] == pytest.approx(3.0, rel=0.01) and first[0] + first[2] + 2.0 == pytest.approx(second[0], abs=0.2)
    lines = re.findall(r'class="whisker" d="M(\S+) (\S+?)V([\d.]+)M', FULL["whiskers"])
    whiskers = [tuple(map(float, each)) for each in lines]
    assert whiskers[0][0] == pytest.approx(first[0] + first[2] / 2.0, abs=0.1)
    px = first[3] / 3.0
    assert [206.0 - whiskers[0][1], 206.0 - whiskers[0][2]] == pytest.approx([2.0 * px, 4.0 * px], abs=0.3)
    assert whiskers[2][1] == 206.0, "the end of an interval below 0 is drawn at 0"
    assert FULL["whiskers"].count("hollow") == 2 and "<title>a: sc 3 ms</title>" in FULL["whiskers"]


def test_hundreds_of_bars_have_a_width_and_some_have_a_name() -> None:
    """600 ages of four silent nodes: every bar was less than nothing wide, and 600 names lay on each other."""
    used = BarGroup(label="used", values=[1.0] * 590)
    many = draw_bars(Bars(title="m", categories=[str(i) for i in range(590)], groups=(used,)))
    assert min(float(each) for each in re.findall(r'<rect class="bar c0"[^>]* width="(\S+)"', many)) > 0.3
    assert [text for *_, text in ticks(many, "middle")] == [str(i) for i in range(0, 590, 50)]


def test_a_histogram_has_a_bar_for_each_count_from_edge_to_edge_and_says_what_it_counts() -> None:
    bars = re.findall(r'<rect class="bar c0" x="(\S+)" y="\S+" width="(\S+)" height="\S+"><title>([^<]*)</title>', FULL["marks"])
    assert [title for *_, title in bars] == ["1 to 2 us: 3", "4 to 8 us: 40"]
    (first, narrow, _), (last, wide, _) = bars
    assert float(first) == 58.0 and float(last) + float(wide) == pytest.approx(547.5, abs=0.1)
    assert (float(wide) + 0.5) / (float(narrow) + 0.5) == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize(
    ("low", "high", "wanted", "ticks"),
    [
        (0.0, 1.0, 5, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]), (0.0, 4.2, 5, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]),
        (-3.0, 7.0, 4, [-5.0, -2.5, 0.0, 2.5, 5.0, 7.5]), (0.0, 30.0, 5, [0.0, 10.0, 20.0, 30.0]), (2.0, 2.0, 5, [2.0]),
    ],
)  # fmt: skip
def test_ticks_enclose_a_range_in_round_steps(low: float, high: float, wanted: int, ticks: list[float]) -> None:
    assert nice_ticks(low, high, wanted) == pytest.approx(ticks)


def test_a_scene_has_one_scale_both_ways_and_its_legend_each_label_once() -> None:
    (path,) = re.findall(r'<path d="([^"]*)" style', FULL["scene"])
    pieces = [[tuple(map(float, point.split())) for point in piece.split("L")] for piece in path.split("M")[1:]]
    assert [len(piece) for piece in pieces] == [3, 1], "the pen is lifted where there is no number"
    (a, b), (c, d), (e, f) = pieces[0]
    assert d == b and e == c and (c - a) / (b - f) == pytest.approx(2.0, rel=0.01)
    below, beside = ticks(FULL["scene"], "middle"), ticks(FULL["scene"], "end")
    assert [text.replace("−", "-") for *_, text in below] == ["-1", "0", "1", "2", "3"]
    assert [x for x, *_ in below] == pytest.approx([a + i * (c - a) / 4.0 for i in range(5)], abs=0.1)
    assert [float(text) for *_, text in beside] == [0.0, 0.5, 1.0, 1.5, 2.0] and {x for x, *_ in beside} == {a - 7.0}
    assert [y - 4.0 for _, y, _ in beside] == pytest.approx([b - i * (b - f) / 4.0 for i in range(5)], abs=0.1)
    assert a - 50.0 == pytest.approx(428.0 - c, abs=0.1), "in the middle of its place"
    for said in ('<text class="axis-label" x="239.0"', ">x</text>", ">y</text></g>"):
        assert said in FULL["scene"]
    wide = draw_scene(Scene(title="s", shapes=(SQUARE,), labels=((9.0, 1.0, "far"),), axes=False))
    assert ">far</text>" in wide and max(float(x) for x in re.findall(r"[ML](\S+?) ", wide)) < 0.5 * 440, "words have room too"
    legend = scene_legend(Scene(title="s", shapes=(SQUARE, SQUARE, Shape(points=[(0.0, 0.0)], label="<b>", colour=9))))
    assert legend.count("way") == 1 and "&lt;b&gt;" in legend and "var(--c1)" in legend
    assert scene_legend(Scene(title="s", shapes=(Shape(points=[(0.0, 0.0)]),))) == ""


def tops(svg: str) -> list[float]:
    return [float(y) for y in re.findall(r'<rect[^>]* y="([\d.]+)"', svg)]


def test_counts_on_a_logarithmic_axis_rise_by_equal_steps_for_equal_factors() -> None:
    one, ten, hundred = tops(
        draw_histogram(Histogram(title="n", edges=np.arange(4.0), counts=np.array([1.0, 10.0, 100.0]), y_log=True))
    )
    assert one - ten == pytest.approx(ten - hundred, abs=0.2) and one - ten > 30.0
    linear = tops(draw_histogram(Histogram(title="n", edges=np.arange(4.0), counts=np.array([1.0, 2.0, 3.0]))))
    assert linear[0] - linear[1] == pytest.approx(linear[1] - linear[2], abs=0.2)


@pytest.mark.parametrize(("most", "top"), [(0.0, 1), (1.0, 1), (10.0, 1), (11.0, 2), (100.0, 2), (101.0, 3)])
def test_a_logarithmic_axis_ends_at_the_power_of_ten_that_holds_all_counts_and_at_ten_at_least(most: float, top: int) -> None:
    svg = draw_histogram(Histogram(title="n", edges=np.arange(2.0), counts=np.array([most]), y_log=True))
    numbers = re.findall(r'class="tick"[^>]*text-anchor="end"[^>]*>([\d.]+)<', svg)
    assert [float(text) for text in numbers] == [10.0**e for e in range(top + 1)]
    bars = tops(svg)
    assert len(bars) == (most > 0.0) and all(18.0 <= y <= 206.0 for y in bars) and (most != 10.0**top or bars == [18.0])


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


def test_a_tall_scene_stands_in_the_middle_with_the_ticks_that_it_reaches() -> None:
    svg = draw_scene(Scene(title="s", shapes=(Shape(points=[(-0.7, -0.3), (0.9, -0.3), (0.9, 5.6)]),), x_label="x", y_label="y"))
    (a, b), (c, _), (_, f) = re.findall(r"[ML](\S+?) ([\d.]+)", re.findall(r'<path d="([^"]*)" style', svg)[0])
    assert float(b) - float(f) == 330.0 and float(a) - 50.0 == pytest.approx(428.0 - float(c), abs=0.1) and float(a) > 100.0
    assert [float(text.replace("−", "-")) for *_, text in ticks(svg, "middle")] == [-0.5, 0.0, 0.5]
    assert [float(text) for *_, text in ticks(svg, "end")] == [0.0, 2.0, 4.0]


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
