import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from hil.pages.html.figures import (
    Badge,
    Band,
    BarGroup,
    Bars,
    Figure,
    Histogram,
    Marker,
    Matrix,
    Section,
    Series,
    Table,
    Text,
    Tile,
)
from hil.pages.html.page import Page

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


def page_with_every_block(text: str) -> str:
    x = np.linspace(0.0, 1.0, 11)
    blocks = (
        Figure(
            title=text,
            x_label=text,
            x_unit=text,
            y_label=text,
            y_unit=text,
            note=text,
            series=(Series(label=text, x=x, y=x),),
            bands=(Band(label=text, x=x, lower=x - 1, upper=x + 1),),
            markers=(Marker(x=0.5, label=text, state="bad"),),
        ),
        Bars(title=text, categories=[text], x_label=text, y_label=text, y_unit=text, note=text,
             groups=(BarGroup(label=text, values=[1.0], whiskers=[(0.8, 1.1)]), BarGroup(label=text, values=[2.0]))),
        Histogram(title=text, edges=[0, 1, 2], counts=[3, 4], x_label=text, x_unit=text, y_label=text, note=text,
                  markers=(Marker(x=1.0, label=text),)),
        Matrix(title=text, rows=[text], columns=[text], values=[[0.5]], row_label=text, column_label=text, note=text),
        Table(title=text, columns=[text], rows=[[text], [Badge(label=text, detail=text)]], note=text),
        Text(title=text, text=text),
        Text(title=text, text=text, code=True, folded=True),
        Badge(label=text, detail=text, state="good"),
    )  # fmt: skip
    return Page(
        text,
        [Section(title=text, intro=text, blocks=blocks, columns=2)],
        kicker=text,
        subtitle=text,
        badges=[Badge(label=text, detail=text)],
        tiles=[Tile(label=text, value=text, unit=text, note=text)],
        facts=[(text, text)],
        footer=text,
    ).html()


def test_hostile_text_adds_no_element_and_no_attribute() -> None:
    harmless, hostile = elements(page_with_every_block("a")), elements(page_with_every_block(HOSTILE))
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
            assert value is None or value.startswith(("#", "data:")), (tag, value)
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
