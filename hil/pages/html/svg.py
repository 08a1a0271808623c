"""Bars, histograms, areas and ways in a plane as SVG, matrices as tables: drawn here, so that they need no script."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from html import escape

import numpy as np

from hil.measure.signals import with_unit
from hil.pages import Bars, Histogram, Marker, Matrix, Scene, Shape
from hil.pages.html import share_text, text_of
from hil.pages.html.payload import Still

WIDTH, HEIGHT = 560, 250
LEFT, RIGHT, TOP, BOTTOM = 58, 12, 18, 44
LETTER = 6.0
"""Width of a letter of a tick, at most nearly."""
EVERY = [factor * 10**decade for decade in range(7) for factor in (1, 2, 5)]
"""Of so many bars one has its name below it, where there is no room for all."""


def still_html(plot: Still) -> str:
    """Return a plot that needs no script to be seen, below its legend."""
    if isinstance(plot, Bars):
        legend, drawn = _legend_of_bars(plot), draw_bars(plot)
    elif isinstance(plot, Scene):
        legend, drawn = scene_legend(plot), draw_scene(plot)
    else:
        legend, drawn = "", draw_histogram(plot) if isinstance(plot, Histogram) else _matrix(plot)
    return f'{legend}<div class="scroll">{drawn}</div>'


def _legend(swatches: Sequence[tuple[str, str]]) -> str:
    """Return labels beside swatches: the attributes of each, and its label."""
    items = "".join(f"<span><i {swatch}></i>{escape(label)}</span>" for swatch, label in swatches)
    return f'<div class="legend">{items}</div>' if items else ""


def _legend_of_bars(bars: Bars) -> str:
    swatches = [
        (f'class="swatch c{(g if group.colour is None else group.colour) % 8}{" hollow" if group.hollow else ""}"', group.label)
        for g, group in enumerate(bars.groups)
    ]
    return _legend(swatches) if len(swatches) > 1 else ""


def draw_bars(bars: Bars) -> str:
    """Return the SVG of grouped bars, with whiskers where a group has intervals."""
    tallest = [
        value if group.whiskers is None else group.whiskers[i][1]
        for group in bars.groups
        for i, value in enumerate(group.values)
        if math.isfinite(value)
    ]
    ticks = nice_ticks(0.0, max([v for v in tallest if math.isfinite(v)], default=1.0) or 1.0)
    y_of = _linear(ticks[0], ticks[-1], HEIGHT - BOTTOM, TOP)
    parts = _frame(ticks, y_of, bars.x_label, with_unit(bars.y_label, bars.y_unit))
    slot = (WIDTH - LEFT - RIGHT) / max(len(bars.categories), 1)
    width = min(0.76 * slot / max(len(bars.groups), 1), 54.0)
    gap = min(2.0, 0.3 * width)
    longest = LETTER * max((len(str(each)) for each in bars.categories), default=1) + 3.0
    named = next(each for each in EVERY if each * slot >= longest)
    for i, category in enumerate(bars.categories):
        middle = LEFT + (i + 0.5) * slot
        if i % named == 0:
            parts.append(_label("tick", middle, HEIGHT - BOTTOM + 16, "middle", str(category)))
        for g, group in enumerate(bars.groups):
            value = float(group.values[i])
            if not math.isfinite(value):
                continue
            left = middle + (g - len(bars.groups) / 2) * width
            top = y_of(value)
            style = _bar_class(group.colour if group.colour is not None else g, group.hollow)
            tip = escape(f"{category}: {group.label} {text_of(value)} {bars.y_unit}".strip())
            parts.append(
                f'<rect class="{style}" x="{left + gap / 2:.1f}" y="{top:.1f}" width="{width - gap:.1f}" '
                f'height="{max(HEIGHT - BOTTOM - top, 0):.1f}"><title>{tip}</title></rect>'
            )
            if group.whiskers is not None and all(map(math.isfinite, group.whiskers[i])):
                x, (low, high) = left + width / 2, (y_of(max(end, 0.0)) for end in group.whiskers[i])
                caps = f"M{x - 4:.1f} {high:.1f}h8M{x - 4:.1f} {low:.1f}h8"
                parts.append(f'<path class="whisker" d="M{x:.1f} {low:.1f}V{high:.1f}{caps}"/>')
    few = len(bars.categories) <= 4 and all(len(str(each)) <= 6 for each in bars.categories)
    return _svg(parts, bars.title, style=f' class="{"few" if few else "many"}"')  # few: whole on a telephone, in larger letters


def draw_histogram(histogram: Histogram) -> str:
    """Return the SVG of a histogram, with vertical lines for the markers."""
    edges = np.asarray(histogram.edges, dtype=np.float64)
    counts = np.asarray(histogram.counts, dtype=np.float64)
    most = float(counts.max()) if counts.size else 1.0
    if histogram.y_log:
        ticks = [10.0**e for e in range(math.ceil(math.log10(max(most, 10.0))) + 1)]
        y_of = _logarithmic(0.6, ticks[-1], HEIGHT - BOTTOM, TOP)
    else:
        ticks = nice_ticks(0.0, most or 1.0)
        y_of = _linear(0.0, ticks[-1], HEIGHT - BOTTOM, TOP)
    low, high = (float(edges[0]), float(edges[-1])) if edges.size > 1 else (0.0, 1.0)
    if histogram.x_log and low > 0:
        x_of = _logarithmic(low, high, LEFT, WIDTH - RIGHT)
        x_ticks = [10.0**e for e in range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)]
        if len(x_ticks) < 3:
            decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)))
            x_ticks = [v for e in decades for m in (1, 2, 5) if low <= (v := m * 10.0**e) <= high]
    else:
        x_of = _linear(low, high, LEFT, WIDTH - RIGHT)
        x_ticks = _ticks_within(low, high)
    parts = _frame(ticks, y_of, with_unit(histogram.x_label, histogram.x_unit), histogram.y_label)
    parts += [_label("tick", x_of(v), HEIGHT - BOTTOM + 16, "middle", text_of(v, 3)) for v in x_ticks]
    style = _bar_class(histogram.colour or 0, False)
    for count, left, right in zip(counts, edges[:-1], edges[1:]):
        if count > 0:
            x, top = x_of(float(left)), y_of(float(count))
            tip = escape(f"{text_of(float(left), 3)} to {text_of(float(right), 3)} {histogram.x_unit}: {int(count)}")
            parts.append(
                f'<rect class="{style}" x="{x:.2f}" y="{top:.1f}" width="{max(x_of(float(right)) - x - 0.5, 0.8):.2f}" '
                f'height="{HEIGHT - BOTTOM - top:.1f}"><title>{tip}</title></rect>'
            )
    parts += _marker_lines([m for m in histogram.markers if low <= m.x <= high], x_of)
    return _svg(parts, histogram.title)


def _marker_lines(markers: Sequence[Marker], x_of: Callable[[float], float]) -> list[str]:
    parts, taken = [], [-1e9, -1e9, -1e9]
    for marker in sorted(markers, key=lambda m: m.x):
        x, width = x_of(marker.x), 6.4 * len(marker.label) + 8
        right_side = x + width < WIDTH - RIGHT
        start = x + 4 if right_side else x - width
        level = next((i for i, end in enumerate(taken) if end <= start), len(taken) - 1)
        taken[level] = start + width
        y = TOP - 6 + 13 * level
        parts.append(f'<path class="mark mark-{marker.state}" d="M{x:.1f} {TOP}V{HEIGHT - BOTTOM}"/>')
        at, anchor = (x + 4, "start") if right_side else (x - 4, "end")
        parts.append(_label("mark-label", at, y + 4, anchor, marker.label))
    return parts


def _frame(ticks: Sequence[float], y_of: Callable[[float], float], x_label: str, y_label: str) -> list[str]:
    parts = []
    for tick in ticks:
        y = y_of(tick)
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}"/>')
        parts.append(_label("tick", LEFT - 7, y + 4, "end", text_of(tick, 3)))
    parts.append(f'<path class="axis" d="M{LEFT} {HEIGHT - BOTTOM}H{WIDTH - RIGHT}"/>')
    return parts + _axis_labels((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 6, x_label, (TOP + HEIGHT - BOTTOM) / 2, y_label)


def _axis_labels(x: float, bottom: float, x_label: str, y: float, y_label: str) -> list[str]:
    upright = _label("axis-label", 0, 0, "middle", y_label)
    return [_label("axis-label", x, bottom, "middle", x_label), f'<g transform="translate(13 {y:.0f}) rotate(-90)">{upright}</g>']


def _label(kind: str, x: float, y: float, anchor: str, text: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _svg(parts: Sequence[str], title: str, *, width: int = WIDTH, height: int = HEIGHT, style: str = "") -> str:
    label = escape(title, quote=True)
    return f'<svg{style} viewBox="0 0 {width} {height}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def _bar_class(colour: int, hollow: bool) -> str:
    return f"bar c{colour % 8}{' hollow' if hollow else ''}"


def _linear(low: float, high: float, start: float, end: float) -> Callable[[float], float]:
    span = (high - low) or 1.0
    return lambda value: start + (value - low) / span * (end - start)


def _logarithmic(low: float, high: float, start: float, end: float) -> Callable[[float], float]:
    position = _linear(math.log10(low), math.log10(high), start, end)
    return lambda value: position(math.log10(max(value, low)))


def nice_ticks(low: float, high: float, wanted: int = 5) -> list[float]:
    """Return ticks of 1, 2, 2.5 or 5 times a power of ten that enclose [low, high]."""
    span = (high - low) or 1.0
    raw = span / wanted
    unit = 10.0 ** math.floor(math.log10(raw))
    step = next(unit * s for s in (1, 2, 2.5, 5, 10) if unit * s >= raw * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [i * step for i in range(first, last + 1)]


def _ticks_within(low: float, high: float, wanted: int = 5) -> list[float]:
    return [tick for tick in nice_ticks(low, high, wanted) if low - 1e-12 <= tick <= high + 1e-12]


SCENE_WIDTH = 440
SCENE_LEFT, SCENE_RIGHT, SCENE_TOP, SCENE_BOTTOM = 50, 12, 12, 42
SCENE_LOW, SCENE_HIGH = 110, 330
"""Least and largest height of what is drawn, px."""


def draw_scene(scene: Scene) -> str:
    """Return the SVG of a scene."""
    points = np.vstack([np.asarray(shape.points, dtype=np.float64) for shape in scene.shapes])
    points = np.vstack([points, *(np.array([[x, y]]) for x, y, _ in scene.labels)])
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-12)
    left, bottom = (SCENE_LEFT, SCENE_BOTTOM) if scene.axes else (SCENE_RIGHT, SCENE_TOP)
    scale = min((SCENE_WIDTH - left - SCENE_RIGHT) / span[0], SCENE_HIGH / span[1])
    drawn = max(scale * span[1], SCENE_LOW)
    height = round(SCENE_TOP + drawn + bottom)
    shift = left + (SCENE_WIDTH - left - SCENE_RIGHT - scale * span[0]) / 2

    def at(x: float, y: float) -> tuple[float, float]:
        return shift + scale * (x - low[0]), SCENE_TOP + (drawn + scale * span[1]) / 2 - scale * (y - low[1])

    parts = [_shape(shape, at) for shape in scene.shapes]
    if scene.axes:
        for tick in _ticks_within(low[0], high[0]):
            parts.append(_label("tick", at(tick, 0.0)[0], height - SCENE_BOTTOM + 18, "middle", text_of(tick, 3)))
        for tick in _ticks_within(low[1], high[1], 4):
            parts.append(_label("tick", at(low[0], 0.0)[0] - 7, at(0.0, tick)[1] + 4, "end", text_of(tick, 3)))
        middle = left + (SCENE_WIDTH - left - SCENE_RIGHT) / 2
        parts += _axis_labels(middle, height - 6, scene.x_label, SCENE_TOP + drawn / 2, scene.y_label)
    for x, y, label in scene.labels:
        px, py = at(x, y)
        anchor = "start" if px < SCENE_WIDTH / 3 else "end" if px > 2 * SCENE_WIDTH / 3 else "middle"
        parts.append(_label("axis-label", px, py, anchor, label))
    return _svg(parts, scene.title, width=SCENE_WIDTH, height=height, style=' style="min-width:0"')


def scene_legend(scene: Scene) -> str:
    """Return the swatches of the shapes that have a label, each once."""
    seen: dict[str, int | None] = {}
    for shape in scene.shapes:
        if shape.label:
            seen.setdefault(shape.label, shape.colour)
    return _legend([(f'class="swatch" style="background:{_ink(colour)}"', label) for label, colour in seen.items()])


def _ink(colour: int | None) -> str:
    return "var(--text)" if colour is None else f"var(--c{colour % 8})"


def _shape(shape: Shape, at: Callable[[float, float], tuple[float, float]]) -> str:
    path, pen = [], "M"
    for x, y in np.asarray(shape.points, dtype=np.float64).tolist():
        if not (np.isfinite(x) and np.isfinite(y)):
            pen = "M"
            continue
        px, py = at(x, y)
        path.append(f"{pen}{px:.1f} {py:.1f}")
        pen = "L"
    ink = _ink(shape.colour)
    if shape.filled:
        style = f"fill:{ink};fill-opacity:.32;stroke:var(--surface);stroke-width:.8"
        path.append("Z")
    else:
        style = f"fill:none;stroke:{ink};stroke-width:{1.0 if shape.faint else 1.6};stroke-linejoin:round" + (
            ";stroke-opacity:.45" if shape.faint else ""
        )
    tip = f"<title>{escape(shape.label)}</title>" if shape.label else ""
    return f'<path d="{"".join(path)}" style="{style}">{tip}</path>'


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
