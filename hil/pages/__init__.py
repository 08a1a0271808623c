"""Pages and figures: runs, comparisons and sweeps as self-contained HTML and for paper; and the live page of a run.

What a page can show is plain data: figures, bars, histograms, matrices, tables, text, badges, tiles. These records know
nothing of HTML, of a run or of an experiment. The author of a page, or of a measure that draws (see
`hil.pages.sections.DrawsSection`), builds a list of `Section` of them; `hil.pages.html.page.Page` is the one place that draws:

    >>> from hil.pages import Figure, Section, Series
    >>> from hil.pages.html.page import Page
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 5)
    >>> panel = Figure(title="Angle", y_label="angle", y_unit="rad", series=(Series(label="angle", x=t, y=t**2),))
    >>> page = Page("Example", [Section(title="Tracking", blocks=(panel,))]).html()
    >>> page.startswith("<!doctype html>")
    True

Every string is shown literally: the renderer escapes, so user text (names, experiment files) needs no care here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from msgspec import Struct

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    FloatArray: TypeAlias = npt.NDArray[np.floating[Any]] | npt.NDArray[np.integer[Any]] | Sequence[float]
    Points: TypeAlias = npt.NDArray[np.float64] | Sequence[tuple[float, float]]
else:  # what a reader of types finds: an array or a list, of which no type says more
    FloatArray = Points = Any

State: TypeAlias = Literal["neutral", "good", "warning", "bad"]
LineStyle: TypeAlias = Literal["line", "dashed", "step", "dashed-step", "points", "circles"]

TIME = "time"
"""The default synchronisation group: all panels of one page in this group zoom together."""


class Series(Struct, frozen=True, kw_only=True):
    """One curve y(x).

    Args:
        x, y: shape (n,), x not decreasing, NaN in y leaves a gap.
        style: "line", "dashed", "step" (holds its value until the next x), "dashed-step", "points", or "circles" (hollow points).
        colour: index into the page's palette of eight (None: by position in the figure).
        faint: thin and pale, for the many runs behind a mean.
        halo: broad and pale, to lie beneath a curve that ought to coincide.
        marked: a point at every x, for a curve of which nothing is known between them.
        samples: how many it had before it was reduced (`hil.pages.html.payload.reduced`); None: it is whole.
    """

    label: str
    x: FloatArray
    y: FloatArray
    style: LineStyle = "line"
    colour: int | None = None
    faint: bool = False
    halo: bool = False
    marked: bool = False
    samples: int | None = None


class Band(Struct, frozen=True, kw_only=True):
    """The area between lower(x) and upper(x), shape (n,) each: a predicted spread, percentiles, a tolerance."""

    label: str
    x: FloatArray
    lower: FloatArray
    upper: FloatArray
    colour: int | None = None


class Marker(Struct, frozen=True, kw_only=True):
    """A vertical line at x with a short label: an event on a time axis, a percentile in a histogram.

    Without a label it is one of many and drawn as a short tick on the panel's upper edge.
    """

    x: float
    label: str
    state: State = "neutral"


class Figure(Struct, frozen=True, kw_only=True, tag=True):
    """An interactive panel: curves, bands and markers over one x axis.

    Panels with the same `sync` group share zoom and cursor (None: a panel of its own). `integer_y` ticks whole numbers only
    (delay modes); `y_names` stand in the place of 0, 1, .... `x_ticks` are the only values that the x axis names, where nothing
    lies between them. `y_range` fixes the y axis (None: fitted to what is visible). `x_log`, `y_log` give logarithmic axes,
    `x_asinh`, `y_asinh` some that are linear up to that size and logarithmic beyond, on both sides of 0. `height_px` is the
    plot's height on screen.
    """

    title: str
    series: tuple[Series, ...]
    bands: tuple[Band, ...] = ()
    markers: tuple[Marker, ...] = ()
    x_label: str = "time"
    x_unit: str = "s"
    y_label: str = ""
    y_unit: str = ""
    x_log: bool = False
    x_asinh: float | None = None
    x_ticks: tuple[float, ...] = ()
    y_log: bool = False
    y_asinh: float | None = None
    integer_y: bool = False
    y_names: tuple[str, ...] = ()
    y_range: tuple[float, float] | None = None
    sync: str | None = TIME
    height_px: int = 240
    note: str = ""


class BarGroup(Struct, frozen=True, kw_only=True):
    """One value per category, e.g. "counted" beside "law". `whiskers` are ends of intervals; `hollow` outlines only."""

    label: str
    values: Sequence[float]
    whiskers: Sequence[tuple[float, float]] | None = None  # low, high
    colour: int | None = None
    hollow: bool = False


class Bars(Struct, frozen=True, kw_only=True, tag=True):
    """Grouped vertical bars over named categories."""

    title: str
    categories: Sequence[str]
    groups: tuple[BarGroup, ...]
    x_label: str = ""
    y_label: str = ""
    y_unit: str = ""
    note: str = ""


class Histogram(Struct, frozen=True, kw_only=True, tag=True):
    """Counts between edges: `edges` of shape (n + 1,) in the axis's unit, `counts` of shape (n,)."""

    title: str
    edges: FloatArray
    counts: FloatArray
    markers: tuple[Marker, ...] = ()
    x_label: str = ""
    x_unit: str = ""
    y_label: str = "count"
    x_log: bool = False
    y_log: bool = False
    colour: int | None = None
    note: str = ""


class Matrix(Struct, frozen=True, kw_only=True):
    """Values shaded by size from `low` to `high`, e.g. frequencies; `expected` is shown small beneath each value."""

    title: str
    rows: Sequence[str]
    columns: Sequence[str]
    values: Sequence[Sequence[float | None]]
    expected: Sequence[Sequence[float | None]] | None = None
    row_label: str = ""
    column_label: str = ""
    low: float = 0.0
    high: float = 1.0
    note: str = ""


class Badge(Struct, frozen=True, kw_only=True):
    """A verdict: label, state (by colour *and* by sign), and a sentence that says why."""

    label: str
    state: State = "neutral"
    detail: str = ""


class Link(Struct, frozen=True, kw_only=True):
    """A cell that leads to another page: the words, and a file beside this page or in a folder below (no other address)."""

    label: str
    href: str

    def __post_init__(self) -> None:
        if {"", "..", "."} & {*self.href.split("/")} or any(sign in self.href for sign in ":\\"):
            raise ValueError(f"href: {self.href!r}, expected a file beside the page or below it")


class Lines(Struct, frozen=True):
    """A cell of several lines, such as a list of assumptions."""

    lines: tuple[str, ...]


Cell: TypeAlias = str | int | float | bool | Badge | Link | Lines | None


class Table(Struct, frozen=True, kw_only=True):
    """Rows of cells. Numbers are set right and to six significant digits; None is a dash.

    `highlight` is the index of rows to set apart (e.g. the best one). A `wide` one takes the page's width, whatever stands
    side by side in its section. A long table scrolls in its own box; a `folded` one stands behind a click on its title.
    A `searched` one has a field that filters its rows, and its rows choose curves of their names (needs the script runs.js).
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""
    note: str = ""
    highlight: frozenset[int] = frozenset()
    wide: bool = False
    folded: bool = False
    searched: bool = False


class Text(Struct, frozen=True, kw_only=True):
    """A paragraph, or with `code` a verbatim block (with `folded` behind a click, closed)."""

    text: str
    title: str = ""
    code: bool = False
    folded: bool = False


class Tile(Struct, frozen=True, kw_only=True):
    """One number that matters, set large: value with unit, a label above and a short note below."""

    label: str
    value: float | int | str | None
    unit: str = ""
    note: str = ""
    state: State = "neutral"


class Shape(Struct, frozen=True, kw_only=True):
    """An area or a way.

    Args:
        points: shape (n, 2); a row with NaN lifts the pen.
        label: what it is; equal labels stand in the legend once.
        colour: index into the page's palette of eight, None for the colour of text.
        filled: an area rather than a way.
        faint: thin and pale.
    """

    points: Points
    label: str = ""
    colour: int | None = None
    filled: bool = False
    faint: bool = False


class Scene(Struct, frozen=True, kw_only=True):
    """Areas and ways in a plane with one scale for both axes: a path over a map, a projected solid.

    Args:
        shapes: at least one; later ones lie above.
        axes: whether the axes have ticks and labels.
        labels: words at points, (x, y, text).
    """

    title: str
    shapes: tuple[Shape, ...]
    axes: bool = True
    x_label: str = ""
    y_label: str = ""
    labels: tuple[tuple[float, float, str], ...] = ()
    note: str = ""


Block: TypeAlias = Figure | Bars | Histogram | Matrix | Scene | Table | Text | Badge


class Section(Struct, frozen=True, kw_only=True):
    """A titled part of a page.

    Args:
        title: its heading, and its entry in the navigation line.
        blocks: what it shows, in order.
        intro: a paragraph above them.
        columns: 1 to 3 blocks stand side by side where the window is wide enough.
        place: among the sections of a run's page, the smaller the earlier. Ours are tracking 10, states and inputs 20, delays 30,
            sensor nodes 40, network 50, timing 60 and 70, summary 80, events 90, wall 5, theory 120, experiment 900.
    """

    title: str
    blocks: tuple[Block, ...]
    intro: str = ""
    columns: int = 1
    place: int = 100
