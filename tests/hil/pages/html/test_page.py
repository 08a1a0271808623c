"""A page is one file that asks for nothing and runs nothing of a text, and hands over all numbers of what it draws."""

import json
import re
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from msgspec import Struct
from msgspec.structs import asdict, replace

from hil.pages import BarGroup, Bars, Figure, Histogram, Matrix, Scene, Section, Series, Shape, Table, Tile
from hil.pages.html.page import Page
from hil.pages.html.svg import draw_bars
from hil.pages.run_page import LoggedRun, runs_page
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
    if isinstance(value, Struct):
        parts = {name: part for name, part in asdict(value).items() if name not in WORDS_OF_OURS}
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


def test_control_characters_and_directions_are_shown_and_not_obeyed() -> None:
    page = page_with_every_block("a\x1b\u202eb")
    assert not set("\x1b\u202e") & set(page) and "<h1>a\\u001b\\u202eb</h1>" in page
    logs = runs_page("runs", [LoggedRun(name=name, page=name, numbers={}) for name in ("javascript:f#1?.html", "\udce9.html")])
    assert [a["href"] for tag, a in elements(logs) if tag == "a"][1:] == ["javascript%3Af%231%3F.html", "%E9.html"]


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


def test_equal_arrays_are_stored_once() -> None:
    x = np.linspace(0, 1, 1001)
    one = Figure(title="f", series=(Series(label="a", x=x, y=x**2),))
    sizes = [len(Page("t", [Section(title="s", blocks=(one,) * n)]).html()) for n in (1, 2)]
    assert sizes[1] - sizes[0] < 1000


def test_not_finite_values_become_gaps() -> None:
    figure = Figure(title="f", series=(Series(label="a", x=[0, 1, 2, 3], y=[1.0, np.inf, np.nan, 2.0]),))
    assert "Infinity" not in Page("t", [Section(title="s", blocks=(figure,))]).html().split('id="hil-data"')[1][:900]


@pytest.mark.parametrize("y_log", [False, True])
@pytest.mark.parametrize("x_log", [False, True])
def test_histogram_draws_every_filled_bin(x_log: bool, y_log: bool) -> None:
    histogram = Histogram(title="h", edges=[1.0, 2.0, 3.0, 40.0], counts=[3, 0, 400], x_log=x_log, y_log=y_log)
    assert Page("t", [Section(title="s", blocks=(histogram,))]).html().partition("<script")[0].count("<rect") == 2


def test_whiskers_end_at_their_values_and_not_below_the_axis() -> None:
    groups = (BarGroup(label="law", values=[0.5, 0.5], whiskers=[(0.25, 0.75), (-1.0, 0.75)]),)
    drawn = draw_bars(Bars(title="b", categories=["a", "b"], groups=groups))
    (inner, cut) = [float(low) for low in re.findall(r'class="whisker" d="M[\d.]+ ([\d.]+)V', drawn)]
    bar = re.search(r'y="([\d.]+)" width="[\d.]+" height="([\d.]+)"', drawn)
    assert bar is not None
    top, foot = float(bar[1]), float(bar[1]) + float(bar[2])
    assert (inner, cut) == pytest.approx(((top + foot) / 2, foot), abs=0.11)  # a tenth of a pixel is written


def test_empty_blocks_are_drawn_empty() -> None:
    blocks = (
        Figure(title="f", series=(Series(label="a", x=[], y=[]),)),
        Bars(title="b", categories=[], groups=()),
        Histogram(title="h", edges=[], counts=[]),
        Table(columns=["a"], rows=[]),
    )
    assert "<table" in Page("t", [Section(title="s", blocks=blocks)]).html()


def test_plots_without_a_script_hand_over_all_of_their_numbers() -> None:
    whiskers = [(0.2, 0.5), (0.1, 0.2)]
    blocks = (
        Histogram(title="h", edges=np.array([0.0, 0.1, 0.3]), counts=np.array([1_234_567_891, 0]), x_label="late", x_unit="us"),
        Bars(title="b", categories=["a", "b"], groups=(BarGroup(label="law", values=[0.25, np.nan], whiskers=whiskers),)),
        Matrix(title="m", rows=["0"], columns=["0", "1"], values=[[0.1, None]], expected=[[0.2, 0.3]], row_label="from"),
        Scene(title="s", shapes=(Shape(points=[(0.0, 1.0), (np.nan, 2.0)], label="way"),), x_label="y (mm)"),
    )
    page = Page("t", [Section(title="s", blocks=blocks)]).html()
    tables = json.loads(page.split('id="hil-data">')[1].partition("</script")[0])["tables"]
    assert [page.count(f'data-numbers="{i}"') for i in range(5)] == [1, 1, 1, 1, 0]
    columns = [{column["name"]: column["values"] for column in table} for table in tables]
    assert columns[0] == {"late (us), from": [0.0, 0.1], "late (us), to": [0.1, 0.3], "count": [1_234_567_891, 0]}
    assert columns[1] == {"category": ["a", "b"], "law": [0.25, None], "law, low": [0.2, 0.1], "law, high": [0.5, 0.2]}
    assert columns[2] == {"from": ["0"], "0": [0.1], "0, expected": [0.2], "1": [None], "1, expected": [0.3]}
    assert columns[3] == {"shape": ["way", "way"], "y (mm)": [0.0, None], "y": [1.0, 2.0]}


def test_a_figure_hands_its_script_ticks_range_and_scales_where_it_has_them() -> None:
    def drawn(**about: Any) -> dict[str, Any]:
        x = np.linspace(1.0, 3.0, 5)
        figure = Figure(title="f", series=(Series(label="s", x=x, y=x),), x_label="mode", x_unit="1", **about)
        page = Page("p", [Section(title="s", blocks=(figure,))]).html()
        data = re.search(r'<script[^>]*id="hil-data"[^>]*>(.*?)</script>', page, re.S)
        assert data is not None
        return json.loads(data[1])["figures"][0]  # type: ignore[no-any-return]

    plain, full = drawn(), drawn(x_ticks=(1.0, 2.0), y_range=(0.0, 4.0), x_log=True, y_log=True, integer_y=True)
    keys = ("xTicks", "yRange", "xLog", "yLog", "integerY")
    assert [plain[key] for key in keys] == [None, None, False, False, False]
    assert [full[key] for key in keys] == [[1.0, 2.0], [0.0, 4.0], True, True, True]
