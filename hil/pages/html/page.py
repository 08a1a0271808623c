"""The shell of every page, and its blocks: one self-contained HTML file that asks no network for anything.

Styles, script, uPlot and the data stand inside the file. A content security policy allows exactly these scripts (by
their SHA-256) and no connection, so that even text that slipped through escaping could not run or call out.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial
from html import escape
from importlib.resources import files
from string import Template
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from msgspec.structs import asdict

from hil.measure.signals import with_unit
from hil.pages import Badge, Band, Block, Cell, Figure, Lines, Link, Section, Series, Table, Text, Tile
from hil.pages.html import capital, text_of
from hil.pages.html.payload import BUCKETS, WHOLE, Payload, Still, bucket_extremes, columns_of, reduced
from hil.pages.html.svg import still_html

SCRIPTS: Final = ("save.js", "save_curves.js", "save_still.js", "page.js")
"""Ours, in the order in which the later ones need the earlier."""

SIGNS = {"good": "✓", "warning": "!", "bad": "✕", "neutral": "·"}

SHORT_CELL = 40
"""Characters of a cell that are kept on one line."""

AMOUNT = re.compile(r"[-−+]?\d.{0,40}")

UNSEEN = re.compile(r"[\0-\b\v\f\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Control characters, and those that turn the direction of a text: they are shown, and in data they are its JSON."""

LONG_TABLE = 40
"""Rows above which a table scrolls in its own box."""


@dataclass(frozen=True, slots=True)
class Page:
    """One self-contained HTML page; all strings are shown literally.

    Args:
        title: heading and window title.
        sections: what the page shows, in order; each becomes an entry of the navigation line.
        kicker: small line above the title, e.g. "hilrig · run report".
        subtitle: a sentence below the title.
        badges: verdicts in the page's head.
        tiles: the few numbers that matter, set large.
        facts: (name, value) pairs in the head, e.g. ("seed", "0").
        footer: a closing line, e.g. the version that wrote the page.
        scripts: more of ours that this page needs, names of assets.
    """

    title: str
    sections: Sequence[Section]
    _: KW_ONLY
    kicker: str = "hilrig"
    subtitle: str = ""
    badges: Sequence[Badge] = ()
    tiles: Sequence[Tile] = ()
    facts: Sequence[tuple[str, str]] = ()
    footer: str = ""
    scripts: Sequence[str] = ()

    def html(self) -> str:
        """Return its text.

        Raises:
            ValueError: a series has x and y of different shapes.
            TypeError: a block is unknown.
        """
        payload = Payload()
        body = "".join(_section(i, section, payload) for i, section in enumerate(self.sections))
        library, script = _asset("uPlot.iife.min.js"), "\n".join(map(_asset, (*SCRIPTS, *self.scripts)))
        policy = (
            "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
            f"script-src {_digest(library)} {_digest(script)}"
        )
        links = "".join(f'<a href="#s{i}">{escape(s.title)}</a>' for i, s in enumerate(self.sections))
        text = Template(f"{_asset('page.html')}\n").substitute(
            policy=policy, title=escape(self.title), style=f"{_asset('uPlot.min.css')}\n{_asset('page.css')}",
            header=_header(self), links=links, body=body, footer=escape(self.footer), data=payload.json(), library=library,
            script=script,
        )  # fmt: skip
        return UNSEEN.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _header(page: Page) -> str:
    parts = [f'<div class="kicker">{escape(page.kicker)}</div>', f"<h1>{escape(page.title)}</h1>"]
    if page.subtitle:
        parts.append(f'<p class="subtitle">{escape(page.subtitle)}</p>')
    if page.badges:
        parts.append(f'<div class="badges">{"".join(map(badge_html, page.badges))}</div>')
    if page.facts:
        pairs = "".join(f"<div><dt>{escape(capital(name))}</dt><dd>{escape(value)}</dd></div>" for name, value in page.facts)
        parts.append(f'<dl class="facts">{pairs}</dl>')
    if page.tiles:
        parts.append(f'<div class="tiles">{"".join(map(tile_html, page.tiles))}</div>')
    return f"<header>{''.join(parts)}</header>"


def _section(number: int, section: Section, payload: Payload) -> str:
    intro = f'<p class="intro">{escape(section.intro)}</p>' if section.intro else ""
    blocks = "\n".join(block_html(block, payload) for block in section.blocks)
    columns = min(max(section.columns, 1), 3)
    return (
        f'<section id="s{number}"><h2>{escape(section.title)}</h2>{intro}'
        f'<div class="grid columns-{columns}">{blocks}</div></section>\n'
    )


def _asset(name: str) -> str:
    # A "</script" in a script would end its element early; uPlot and ours have none, and a test holds them to it.
    return files("hil.pages.html").joinpath("assets", name).read_text(encoding="utf-8").strip()


def _digest(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def block_html(block: Block, payload: Payload) -> str:
    """Return the HTML of one block.

    Raises:
        TypeError: for anything that is not one of the blocks of `hil.pages`.
    """
    if isinstance(block, Figure):
        return _figure(block, payload)
    if isinstance(block, Still):  # it needs no script to be seen; with one it can be saved
        return _panel(block.title, still_html(block), block.note, numbers=payload.numbers(columns_of(block)))
    if isinstance(block, Table):
        return _table(block)
    if isinstance(block, Text):
        return _text(block)
    if isinstance(block, Badge):
        return badge_html(block)
    raise TypeError(f"block: expected one of the blocks of hil.pages, got {type(block).__name__}")


def badge_html(badge: Badge) -> str:
    """Return a verdict: a sign and a colour, so that neither is needed alone."""
    detail = f'<span class="detail">{escape(badge.detail)}</span>' if badge.detail else ""
    sign = f'<span class="sign" aria-hidden="true">{SIGNS[badge.state]}</span>'
    return f'<span class="badge {badge.state}">{sign}<span class="what">{escape(badge.label)}</span>{detail}</span>'


def tile_html(tile: Tile) -> str:
    """Return one large number with its label, unit and note."""
    unit = f'<span class="unit">{escape(tile.unit)}</span>' if tile.unit and tile.value is not None else ""
    note = f'<div class="note">{escape(tile.note)}</div>' if tile.note else ""
    return (
        f'<div class="tile {tile.state}"><div class="label">{escape(tile.label)}</div>'
        f'<div class="value">{escape(text_of(tile.value))}{unit}</div>{note}</div>'
    )


def _panel(title: str, body: str, note: str, kind: str = "panel", numbers: int | None = None) -> str:
    head = f"<h3>{escape(title)}</h3>" if title else ""
    foot = f"<figcaption>{escape(note)}</figcaption>" if note else ""
    saved = "" if numbers is None else f' data-numbers="{numbers}"'
    return f'<figure class="{kind}"{saved}>{head}{body}{foot}</figure>'


def _figure(figure: Figure, payload: Payload) -> str:
    number = len(payload.figures)
    note = figure.note
    curves, whole, drawn = [], 0, 0
    for i, series in enumerate(figure.series):
        x, y = _arrays(series.label, series.x, series.y)
        samples, step = series.samples, "step" in series.style
        if samples is None:
            x, y, samples = reduced(partial(iter, [(x, y)]), step=step)
        whole, drawn = max(whole, samples), max(drawn, 0 if step else x.size)
        look = {name: getattr(series, name) for name in ("label", "style", "faint", "halo", "marked")}
        curves.append(look | {"colour": _colour(series, i), "x": payload.add(x), "y": payload.add(y)})
    bands = []
    for i, band in enumerate(figure.bands):
        x, lower = _arrays(band.label, band.x, band.lower)
        x, upper = _arrays(band.label, band.x, band.upper)
        keep = np.union1d(_reduced(x, lower), _reduced(x, upper))
        ends = {name: payload.add(values[keep]) for name, values in (("x", x), ("lower", lower), ("upper", upper))}
        bands.append({"label": band.label, "colour": _colour(band, i), **ends})
    payload.figures.append({
        "series": curves, "bands": bands, "markers": [asdict(marker) for marker in figure.markers],
        "xLabel": with_unit(figure.x_label, figure.x_unit), "yLabel": with_unit(figure.y_label, figure.y_unit),
        "xLog": figure.x_log, "xAsinh": figure.x_asinh, "xTicks": figure.x_ticks or None, "yLog": figure.y_log,
        "yAsinh": figure.y_asinh, "integerY": figure.integer_y, "yRange": figure.y_range, "sync": figure.sync,
        "height": figure.height_px, **({"yNames": figure.y_names} if figure.y_names else {}),
    })  # fmt: skip
    if drawn and drawn < whole:
        fewer = f"Drawn as the minimum and maximum of {text_of(BUCKETS)} intervals of {text_of(whole)} samples."
        note = f"{note} {fewer}".strip()
    label = escape(f"{figure.title}: {', '.join(s.label for s in figure.series)}", quote=True)
    place = f'data-figure="{number}" style="min-height:{figure.height_px}px"'
    body = f'<div class="plot" role="img" aria-label="{label}" {place}></div>'
    return _panel(figure.title, body, note)


def _colour(of: Series | Band, place: int) -> int:
    return (place if of.colour is None else of.colour) % 8


def _arrays(
    label: str, x: Sequence[float] | npt.NDArray[Any], y: Sequence[float] | npt.NDArray[Any]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    x_values, y_values = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if x_values.ndim != 1 or x_values.shape != y_values.shape:
        shapes = f"x has shape {x_values.shape}, y {y_values.shape}"
        raise ValueError(f"series {label!r}: {shapes}, expected one dimension and equal length")
    return x_values, np.where(np.isfinite(y_values), y_values, np.nan)


def _reduced(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
    return np.arange(x.size, dtype=np.intp) if x.size <= WHOLE else bucket_extremes(x, y, BUCKETS)


def _table(table: Table) -> str:
    columns = [[row[j] for row in table.rows] for j in range(len(table.columns))]
    numeric = [bool(column) and all(map(_is_number, column)) for column in columns]
    kinds = [' class="number"' if n else ' class="amount"' if _amounts(column) else "" for n, column in zip(numeric, columns)]
    head = "".join(f'<th scope="col"{kinds[j]}>{escape(str(c))}</th>' for j, c in enumerate(table.columns))
    lines = []
    for i, row in enumerate(table.rows):
        cells = "".join(f"<td{kinds[j]}{_exact(cell, table)}>{_cell(cell)}</td>" for j, cell in enumerate(row))
        lines.append(f"<tr{' class=highlight' if i in table.highlight else ''}>{cells}</tr>")
    # The last column takes what the others leave, unless they hold sentences too: then all of them wrap.
    widest = max((len(_words(cell)) for row in table.rows for cell in row[:-1]), default=0)
    kind = "" if numeric[-1] or widest > SHORT_CELL else ' class="prose-last"' if len(table.columns) > 2 else ""
    kind = ' class="pairs"' if len(table.columns) == 2 and not numeric[-1] else kind
    scroll = "scroll long" if len(table.rows) > LONG_TABLE else "scroll"
    kind += " data-searched" * table.searched
    body = f"<table{kind}><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
    kind = "panel wide" if table.wide else "panel"
    body = f'<div class="{scroll}">{body}</div>'
    if table.folded:
        return _panel("", f"<details><summary>{escape(table.title)}</summary>{body}</details>", table.note, kind)
    return _panel(table.title, body, table.note, kind)


def _exact(cell: Cell, table: Table) -> str:
    """The number of a cell for the script that subtracts them."""
    return f' data-value="{cell!r}"' if table.searched and isinstance(cell, int | float) else ""


def _words(cell: Cell) -> str:
    if isinstance(cell, Link):
        return cell.label
    if isinstance(cell, Lines):
        return " ".join(cell.lines)
    return f"{cell.label} {cell.detail}" if isinstance(cell, Badge) else str(cell)


def _is_number(cell: Cell) -> bool:
    return cell is None or (isinstance(cell, int | float) and not isinstance(cell, bool))


def _amounts(column: Sequence[Cell]) -> bool:
    """Whether a column holds amounts, such as 25 ms, and intervals: a line's end within one takes it apart."""
    return all(_is_number(cell) or (isinstance(cell, str) and AMOUNT.fullmatch(cell)) for cell in column)


def _cell(cell: Cell) -> str:
    if isinstance(cell, Badge):
        return badge_html(cell)
    if isinstance(cell, Link):
        return f'<a href="{escape(cell.href, quote=True)}">{escape(cell.label)}</a>'
    if isinstance(cell, Lines):
        return "".join(f"<p>{escape(line)}</p>" for line in cell.lines)
    return escape(text_of(cell, 6) if isinstance(cell, float) else text_of(cell))


def _text(text: Text) -> str:
    if not text.code:
        return _panel(text.title, f"<p>{escape(text.text)}</p>", "", "prose")
    body = f'<pre tabindex="0"><code>{escape(text.text)}</code></pre>'
    if text.folded:
        body = f"<details><summary>{escape(text.title or 'Show')}</summary>{body}</details>"
        return _panel("", body, "", "panel code")
    return _panel(text.title, body, "", "panel code")
