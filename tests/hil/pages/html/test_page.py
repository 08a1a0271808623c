"""A page is one file that asks for nothing and runs nothing of a text; what is drawn lies in its box, and no word on another."""

import json
import re
from dataclasses import fields, is_dataclass, replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from hil.pages.html.figures import BarGroup, Bars, Figure, Histogram, Marker, Scene, Section, Series, Shape, Tile
from hil.pages.html.page import Page
from hil.pages.html.svg import draw_bars, draw_histogram, draw_scene, nice_ticks
from tests.hil.pages.whole_pages import GOOD, SECTIONS

HOSTILE = '</script><script>alert("x")</script><img src=x onerror=alert(1)>&"\''


class Elements(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def elements(page: str) -> list[tuple[str, dict[str, str | None]]]:
    parser = Elements()
    parser.feed(page)
    return parser.found


WORDS_OF_OURS = {"style", "state", "sync", "href"}


def said(value: Any, text: str) -> Any:
    """Return what is shown with every text of it replaced."""
    if isinstance(value, str):
        return text
    if is_dataclass(value) and not isinstance(value, type):
        parts = {each.name: getattr(value, each.name) for each in fields(value) if each.name not in WORDS_OF_OURS}
        return replace(value, **{name: said(part, text) for name, part in parts.items()})
    return [said(part, text) for part in value] if isinstance(value, list | tuple) else value


def page_with_every_block(text: str) -> str:
    tiles, badges = [Tile(label=text, value=text, unit=text, note=text)], [said(GOOD, text)]
    return Page(text, said(SECTIONS, text), kicker=text, subtitle=text, badges=badges, tiles=tiles, facts=[(text, text)],
                footer=text).html()  # fmt: skip


def test_hostile_text_adds_no_element_and_no_attribute() -> None:
    harmless, hostile = elements(page_with_every_block("a" * len(HOSTILE))), elements(page_with_every_block(HOSTILE))
    assert [tag for tag, _ in hostile] == [tag for tag, _ in harmless]
    assert [sorted(a) for _, a in hostile] == [sorted(a) for _, a in harmless]


def test_no_text_ends_the_scripts_data_or_opens_a_comment_in_it() -> None:
    """`</script` alone ends it, whatever follows; `<!--<script` would make its own end none."""
    for text in (HOSTILE, "</script x", "<!--<script", "&lt;"):
        data = re.search(r'<script[^>]*id="hil-data"[^>]*>(.*?)</script>', page_with_every_block(text), re.S)
        assert data is not None and not set("<>&") & set(data[1])
        assert json.loads(data[1])["figures"][0]["series"][0]["label"] == text


def test_page_refers_to_nothing_outside_itself() -> None:
    page = page_with_every_block("a")
    for tag, attributes in elements(page):
        assert tag not in {"iframe", "object", "embed", "base"}
        for name in ("src", "href", "srcset", "action", "poster"):
            value = attributes.get(name)
            assert value in (None, "a.html") or value.startswith(("#", "data:")), (tag, value)
    styles = "".join(re.findall(r"<style>(.*?)</style>", page, re.S))
    assert "url(" not in styles and "@import" not in styles


def test_policy_allows_exactly_the_scripts_of_the_page() -> None:
    page = page_with_every_block("a")
    policy = next(a["content"] for t, a in elements(page) if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None and policy.startswith("default-src 'none'")
    assert policy.count("'sha256-") == 2 and "unsafe-inline'; script" not in policy.split("script-src")[1]
    assert page.count("</script") == 3


def test_series_of_unequal_length_is_refused_by_its_label() -> None:
    figure = Figure(title="f", series=(Series(label="angle", x=[0.0, 1.0], y=[0.0]),))
    with pytest.raises(ValueError, match="series 'angle'"):
        Page("t", [Section(title="s", blocks=(figure,))]).html()


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
