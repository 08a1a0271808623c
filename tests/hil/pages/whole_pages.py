"""Lines of a page: of HTML, of what its script draws, of what a paper shows; and the page of every block.

Numbers are rounded so that neither a CPU nor LAPACK decides: of arrays four digits of the largest.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hil.pages import (
    Badge,
    Band,
    BarGroup,
    Bars,
    Figure,
    Histogram,
    Lines,
    Link,
    Marker,
    Matrix,
    Scene,
    Section,
    Series,
    Shape,
    Table,
    Text,
    Tile,
)
from hil.pages.html.page import Page
from hil.pages.paper import Plot, draw

DATA = re.compile(r'<script[^>]*id="hil-data"[^>]*>(.*?)</script>', re.S)
LINE = re.compile(r"\n|(?=<(?:section|figure|div|p|tr|svg|path|rect|text|g|dl|figcaption|details)\b)")
AXES = ("x", "y", "lower", "upper")
KINDS = {"i2": "<i2", "f4": "<f4", "f8": "<f8"}


def digests(given: Sequence[str]) -> list[str]:
    """Return three letters for each line."""
    return [base64.urlsafe_b64encode(hashlib.sha256(line.encode()).digest())[:3].decode() for line in given]


def lines(page: str) -> dict[str, list[str]]:
    """Return the lines of the head, and of each section with what its figures draw."""
    data = DATA.search(page)
    assert data is not None
    told, body = json.loads(data[1]), re.sub(r"<code>.*?</code>", "<code>", page[page.index("<body>") : data.start()], flags=re.S)
    body = re.sub(r'<h2>Provenance</h2>.*?</section>|(?<=<meta http-equiv="Content-Security-Policy")[^>]*', "", body, flags=re.S)
    arrays = [_array(each) for each in told["arrays"]]
    found: dict[str, list[str]] = {}
    for i, part in enumerate(re.split(r"(?=<section )|(?=<footer>)", body)):
        title = re.search(r"<h2>(.*?)</h2>", part)
        own = found.setdefault(title[1] if title else f"part {i}", [])
        own += [line for line in LINE.split(part) if line.strip()]
        own += [
            line for number in re.findall(r'data-figure="(\d+)"', part) for line in _drawn(told["figures"][int(number)], arrays)
        ]
        own += [json.dumps(told["tables"][int(number)]) for number in re.findall(r'data-numbers="(\d+)"', part)]
    return found


def _array(stored: dict[str, str]) -> np.ndarray:
    values = np.frombuffer(base64.b64decode(stored["d"]), KINDS[stored["t"]]).astype(np.float64)
    return np.where(values == -32768, np.nan, values) if stored["t"] == "i2" else values


def rounded(values: np.ndarray) -> str:
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    digit = 10.0 ** (np.floor(np.log10(largest) + 1e-9) - 3) if largest else 1.0
    told = ",".join("-" if np.isnan(v) else f"{v:.0f}" for v in np.round(values / digit) + 0.0)
    return (
        f"{values.size} x {digit:.0e}: {told}"
        if values.size <= 8
        else f"{values.size} x {digit:.0e} {hashlib.sha256(told.encode()).hexdigest()}"
    )


def _drawn(figure: dict[str, Any], arrays: Sequence[np.ndarray]) -> list[str]:
    curves = [
        ", ".join(f"{name}: {rounded(arrays[v]) if name in AXES else v}" for name, v in sorted(curve.items()))
        for curve in figure["series"] + figure["bands"]
    ]
    about = [f"{name}: {value}" for name, value in figure.items() if name not in ("series", "bands")]
    return [*curves, *about]


X: Final = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 4.0])
GAPS: Final = np.array([-1.25, 0.0, np.nan, np.inf, 3e-5, 2.0])
WAY: Final = [(-1.0, 0.0), (3.0, 0.0), (3.0, 2.0), (np.nan, np.nan), (-1.0, 2.0), (0.5, 0.25)]
MARKS: Final = tuple(
    Marker(x=x, label=label, state=state)
    for x, label, state in (
        (2.0, "a", "bad"), (2.05, "behind it", "warning"), (2.1, "third", "good"), (2.15, "fourth", "neutral"),
        (7.9, "at the right end", "bad"), (9.0, "beyond", "bad"), (3.0, "", "neutral"),
    )
)  # fmt: skip
FIGURES: Final[tuple[Plot, ...]] = (
    Figure(
        title="Curves <&>", x_unit="", y_label="angle", y_unit="rad", note="a note", markers=MARKS,
        series=(
            Series(label="line", x=X, y=GAPS), Series(label="dashed", x=X, y=X**3, style="dashed", halo=True),
            Series(label="step", x=X, y=[0, 0, 1, 1, 2, 2], style="step", faint=True), Series(label="big", x=X, y=1e40 * X),
            Series(label="held", x=X, y=X > 1, style="dashed-step", colour=7),
            Series(label="dots", x=X, y=1 + 1e-9 * X, style="points"),
            Series(label="circles", x=X, y=X, style="circles", colour=11, marked=True),
            Series(label="fewer", x=X, y=X, samples=10**6),
            Series(label="last", x=X, y=np.full(6, np.nan)), Series(label="ninth", x=[], y=[]),
        ),
        bands=(Band(label="spread", x=X, lower=X - 1, upper=X**2), Band(label="other", x=X, lower=-X, upper=X, colour=9)),
    ),
    Figure(title="Scales", series=(Series(label="alone", x=X + 0.1, y=X, marked=True),), x_label="mode", x_log=True, y_asinh=0.5,
           x_ticks=(0.1, 1.0), y_range=(-1.0, 5.0), sync=None, height_px=165, integer_y=True),
    Figure(title="Others", series=(Series(label="alone", x=X, y=X + 0.1, samples=30_000, style="step"),), x_asinh=2.0,
           y_log=True),
    Bars(title="Whiskers", categories=("a", "b", "c"), x_label="node", y_label="delay", y_unit="ms", note="of three", groups=(
        BarGroup(label="sc", values=[3.0, 1.0, 2.0], whiskers=[(2.0, 4.2), (0.5, 1.5), (-1.0, np.inf)]),
        BarGroup(label="ca", values=[1.0, np.nan, 4.0], hollow=True),
        BarGroup(label="<third>", values=[0.0, 1.0, 1.0], colour=12),
    )),
    Bars(title="Many", categories=[f"{i:07}" for i in range(6)], groups=(BarGroup(label="alone", values=np.arange(6) * 0.07),)),
    Bars(title="None", categories=(), groups=()),
    Histogram(title="Counts", edges=[1.0, 2.0, 4.0, 8.0], counts=[3, 0, 40], x_label="late", x_unit="us", markers=MARKS,
              note="n"),
    Histogram(title="Decades", edges=np.array([0.5, 30.0, 2e4]), counts=np.array([1.0, 2000.0]), x_log=True, y_log=True,
              colour=2),
    Histogram(title="Few decades", edges=[3.0, 20.0, 400.0], counts=[1, 101], x_log=True, y_log=True, y_label="slots"),
    Histogram(title="Nothing", edges=[], counts=[]),
    Matrix(title="Chain", rows=["0", "1"], columns=["0", "<1>"], values=[[0.1, None], [0.42, 1.7]], row_label="from",
           column_label="to",
           expected=[[0.15, 0.85], [None, 1234.0]], note="shares"),
    Matrix(title="Means", rows=["x"], columns=["y", "z"], values=[[-3.0, 5.0]], low=-3.0, high=9.0, column_label="only"),
    Scene(title="Axes", x_label="y (mm)", y_label="z (mm)", note="a map", shapes=(
        Shape(points=WAY, label="way"), Shape(points=[(0, 0), (1, 0), (1, 1)], label="area", colour=10, filled=True),
        Shape(points=[(0.0, 0.0), (2.5, 1.5)], label="way", faint=True, colour=3), Shape(points=[(0.0, 1.0)]),
    )),
    Scene(title="Words", axes=False, shapes=(Shape(points=[(0.0, 0.0), (4.0, 1.0)]),),
          labels=((0.0, 0.5, "west"), (2.0, 0.5, "amid"), (4.0, 0.5, "<east>"))),
    Scene(title="Tall", shapes=(Shape(points=[(-0.7, -0.3), (0.9, -0.3), (0.9, 5.6)]),), x_label="x", y_label="y"),
    Scene(title="Flat", shapes=(Shape(points=[(0.0, 2.0), (9.0, 2.0)]),), x_label="x", y_label="y"),
)  # fmt: skip
GOOD: Final = Badge(label="good <b>", state="good", detail="because & so")
SECTIONS: Final = (
    Section(title="Plots & <more>", blocks=FIGURES, intro="What is <drawn>", columns=2),
    Section(title="Tables", columns=7, blocks=(
        Table(columns=["number", "text", "amount", "last"], title="Numbers <t>", note="A note", highlight=frozenset({1}), rows=[
            [1, "one", "25 ms", "a sentence at the end that is long enough to be one, and goes on"],
            [-2.5e-7, "two", "−1 to 3", None], [123456789, True, None, "short"], [None, 1.23456789, "4.5 N s/m", "end"],
        ]),
        Table(columns=["question", "answer"], title="Pairs", wide=True, folded=True, note="below",
              rows=[["what", Lines(("one", "<two>"))], ["why", GOOD], ["where", Link(label="<here>", href="a.html")]]),
        Table(columns=["run", "sse"], rows=[[f"run {i}", i / 3] for i in range(41)], searched=True, wide=True),
        Table(columns=["sentences", "both", "columns"], rows=[["x" * 41, "y", "z"], [GOOD, "y" * 39, "z"]]),
        Table(columns=["sentence", "badge", "words"], rows=[["x" * 40, Badge(label="b" * 20, detail="d" * 20), "z" * 50]]),
        Table(columns=["a", "b"], rows=[[1, 2.0]]), Table(columns=["nothing"], rows=[]),
        Text(text="<prose>", title="Said"), Text(text="code", code=True, title="Code"), Text(text="code", code=True, folded=True),
        Text(text="plain"), GOOD, Badge(label="bad", state="bad"), Badge(label="warning", state="warning"),
        Badge(label="neutral"),
    )),
)  # fmt: skip
NUMBERS: Final = (0, 7, -1234567, True, None, "text", 0.0, -0.5, 12.0345678, 9999.96, 1e-4, 9.9e-5, -1e-9, 1e7, 9.99e6,
                  123456.789,
                  np.inf, -np.inf, np.nan, 1.0, 100.0, 0.00012345)  # fmt: skip


def every_block() -> dict[str, list[str]]:
    """What a page can show, once."""
    tiles = [
        Tile(label=f"<{value}>", value=value, unit="V" * (i % 2), note="n" * (i % 3), state="warning")
        for i, value in enumerate(NUMBERS)
    ]
    page = Page("Title <&>", SECTIONS, kicker="k <", subtitle="s <", badges=[GOOD], tiles=tiles, facts=[("f <", "v <")],
                footer="end <",
                scripts=("runs.js",)).html()  # fmt: skip
    bare = Page("Bare", []).html()
    kinds = [f"{each['t']} {len(each['d'])}" for each in json.loads(DATA.search(page)[1])["arrays"]]  # type: ignore[index]
    policy = [
        page.split("<style>")[0].split("script-src")[0],
        *(f"{page.count(each)} {each}" for each in ("<script", "<style", "sha256")),
    ]
    return lines(page) | {f"bare {name}": own for name, own in lines(bare).items()} | {"kinds": kinds, "shell": policy}


LOOKS: Final = ("label", "text", "position", "xydata", "xy", "data", "array", "clim", "x", "y", "width", "height", "alpha",
                "color",
                "edgecolor", "facecolor", "linestyle", "linewidth", "drawstyle", "marker", "markersize",
                "markerfacecolor")  # fmt: skip


def paper() -> dict[str, list[str]]:
    """What a paper shows of each plot."""
    from matplotlib.figure import Figure as Sheet  # runs take nothing of it

    found = {}
    for plot in (each for each in FIGURES if each.title != "Nothing"):
        draw(plot, axis := Sheet().subplots())
        found[plot.title] = [*axis_lines(axis), _told(axis.get_ylim()) if getattr(plot, "y_range", None) else ""]
    return found


def axis_lines(axis: Any) -> list[str]:
    """Return what a plot of matplotlib shows; where its axes end and what they name by themselves is matplotlib's."""
    named = [side for side in (axis.xaxis, axis.yaxis) if type(side.get_major_locator()).__name__ == "FixedLocator"]
    return [
        *map(_look, (*axis.lines, *axis.patches, *axis.collections, *axis.texts, *axis.images)),
        f"{axis.get_xscale()} {axis.get_yscale()} {axis.get_xlabel()} {axis.get_ylabel()} {axis.get_aspect()} {axis.axison}",
        *(f"{_told(side.get_ticklocs())} {[text.get_text() for text in side.get_ticklabels()]}" for side in named),
        *(text.get_text() for text in (axis.get_legend().get_texts() if axis.get_legend() else ())),
    ]


def _look(artist: Any) -> str:
    """Say of what is drawn where it stands, and how it looks."""
    said = {name: _told(getattr(artist, f"get_{name}")()) for name in LOOKS if hasattr(artist, f"get_{name}")}
    paths = [_told(path.vertices) for path in artist.get_paths()] if hasattr(artist, "get_paths") else []
    return f"{type(artist).__name__} {said} {paths}"


def _told(value: Any) -> str:
    try:
        return str([f"{v:.5g}" for v in np.ma.filled(np.ma.asarray(value, dtype=np.float64), np.nan).ravel()])
    except (TypeError, ValueError):
        return str(value)
