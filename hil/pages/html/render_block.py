"""One block of a page to HTML; what the script draws or saves is collected in a `Payload`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.measure.signals import with_unit
from hil.pages.html.decimation import BUCKETS, WHOLE, bucket_extremes, reduced
from hil.pages.html.figures import (
    Badge,
    Bars,
    Block,
    Cell,
    Figure,
    Histogram,
    Lines,
    Link,
    Matrix,
    Scene,
    Table,
    Text,
    Tile,
)
from hil.pages.html.numbers import share_text, text_of
from hil.pages.html.payload import Payload, Still, columns_of
from hil.pages.html.svg import draw_bars, draw_histogram, draw_scene, scene_legend

SIGNS = {"good": "✓", "warning": "!", "bad": "✕", "neutral": "·"}

SHORT_CELL = 40
"""Characters of a cell that are kept on one line."""

AMOUNT = re.compile(r"[-−+]?\d.{0,40}")

LONG_TABLE = 40
"""Rows above which a table scrolls in its own box."""


def block_html(block: Block, payload: Payload) -> str:
    """Return the HTML of one block.

    Raises:
        TypeError: for anything that is not one of the block dataclasses of `hil.pages.html.figures`.
    """
    if isinstance(block, Figure):
        return _figure(block, payload)
    if isinstance(block, Bars):
        return _still(block, f'{_legend(block)}<div class="scroll">{draw_bars(block)}</div>', payload)
    if isinstance(block, Histogram):
        return _still(block, f'<div class="scroll">{draw_histogram(block)}</div>', payload)
    if isinstance(block, Scene):
        return _still(block, f'{scene_legend(block)}<div class="scroll">{draw_scene(block)}</div>', payload)
    if isinstance(block, Matrix):
        return _still(block, f'<div class="scroll">{_matrix(block)}</div>', payload)
    if isinstance(block, Table):
        return _table(block)
    if isinstance(block, Text):
        return _text(block)
    if isinstance(block, Badge):
        return badge_html(block)
    raise TypeError(f"block: expected one of the dataclasses of hil.pages.html.figures, got {type(block).__name__}")


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


def _still(block: Still, body: str, payload: Payload) -> str:
    """Return a plot that needs no script to be seen; with one it can be saved."""
    return _panel(block.title, body, block.note, numbers=payload.numbers(columns_of(block)))


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
        curves.append(
            {
                "label": series.label,
                "colour": (i if series.colour is None else series.colour) % 8,
                "style": series.style,
                "faint": series.faint,
                "halo": series.halo,
                "marked": series.marked,
                "x": payload.add(x),
                "y": payload.add(y),
            }
        )
    bands = []
    for i, band in enumerate(figure.bands):
        x, lower = _arrays(band.label, band.x, band.lower)
        x, upper = _arrays(band.label, band.x, band.upper)
        keep = np.union1d(_reduced(x, lower), _reduced(x, upper))
        bands.append(
            {
                "label": band.label,
                "colour": (i if band.colour is None else band.colour) % 8,
                "x": payload.add(x[keep]),
                "lower": payload.add(lower[keep]),
                "upper": payload.add(upper[keep]),
            }
        )
    payload.figures.append(
        {
            "series": curves,
            "bands": bands,
            "markers": [{"x": float(m.x), "label": m.label, "state": m.state} for m in figure.markers],
            "xLabel": with_unit(figure.x_label, figure.x_unit),
            "yLabel": with_unit(figure.y_label, figure.y_unit),
            "xLog": figure.x_log,
            "xAsinh": figure.x_asinh,
            "xTicks": list(figure.x_ticks) or None,
            "yLog": figure.y_log,
            "yAsinh": figure.y_asinh,
            "integerY": figure.integer_y,
            "yRange": list(figure.y_range) if figure.y_range is not None else None,
            "sync": figure.sync,
            "height": figure.height_px,
        }
    )
    if drawn and drawn < whole:
        fewer = f"Drawn as the minimum and maximum of {text_of(BUCKETS)} intervals of {text_of(whole)} samples."
        note = f"{note} {fewer}".strip()
    label = escape(f"{figure.title}: {', '.join(s.label for s in figure.series)}", quote=True)
    place = f'data-figure="{number}" style="min-height:{figure.height_px}px"'
    body = f'<div class="plot" role="img" aria-label="{label}" {place}></div>'
    return _panel(figure.title, body, note)


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


def _legend(bars: Bars) -> str:
    if len(bars.groups) < 2:
        return ""
    items = []
    for g, group in enumerate(bars.groups):
        colour = (g if group.colour is None else group.colour) % 8
        swatch = f'<i class="swatch c{colour}{" hollow" if group.hollow else ""}"></i>'
        items.append(f"<span>{swatch}{escape(group.label)}</span>")
    return f'<div class="legend">{"".join(items)}</div>'


def _matrix(matrix: Matrix) -> str:
    corner = escape(f"{matrix.row_label} \\ {matrix.column_label}" if matrix.row_label else "")
    head = "".join(f'<th scope="col">{escape(str(c))}</th>' for c in matrix.columns)
    lines = []
    for i, name in enumerate(matrix.rows):
        cells = []
        for j, value in enumerate(matrix.values[i]):
            expected = matrix.expected[i][j] if matrix.expected is not None else None
            small = "" if expected is None else f"<small>{share_text(float(expected))}</small>"
            number = float("nan") if value is None else float(value)
            share = (number - matrix.low) / ((matrix.high - matrix.low) or 1.0)
            shade = min(max(share, 0.0), 1.0) if np.isfinite(share) else 0.0
            cells.append(f'<td style="--shade:{shade:.3f}">{share_text(number)}{small}</td>')
        lines.append(f'<tr><th scope="row">{escape(str(name))}</th>{"".join(cells)}</tr>')
    top = f"<thead><tr><th>{corner}</th>{head}</tr></thead>"
    return f'<table class="matrix">{top}<tbody>{"".join(lines)}</tbody></table>'


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
