"""Areas and ways in a plane as SVG, one scale for both axes: a path over a map, or a solid that was projected before."""

from __future__ import annotations

from collections.abc import Callable
from html import escape

import numpy as np

from hil.pages.html.figures import Scene, Shape
from hil.pages.html.numbers import text_of
from hil.pages.html.svg import nice_ticks

WIDTH = 440
LEFT, RIGHT, TOP, BOTTOM = 50, 12, 12, 42
LOW, HIGH = 110, 330
"""Least and largest height of what is drawn, px."""


def draw_scene(scene: Scene) -> str:
    """Return the SVG of a scene."""
    points = np.vstack([np.asarray(shape.points, dtype=np.float64) for shape in scene.shapes])
    points = np.vstack([points, *(np.array([[x, y]]) for x, y, _ in scene.labels)])
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-12)
    left, bottom = (LEFT, BOTTOM) if scene.axes else (RIGHT, TOP)
    scale = min((WIDTH - left - RIGHT) / span[0], HIGH / span[1])
    drawn = max(scale * span[1], LOW)
    height = round(TOP + drawn + bottom)
    shift = left + (WIDTH - left - RIGHT - scale * span[0]) / 2

    def at(x: float, y: float) -> tuple[float, float]:
        return shift + scale * (x - low[0]), TOP + (drawn + scale * span[1]) / 2 - scale * (y - low[1])

    parts = [_shape(shape, at) for shape in scene.shapes]
    if scene.axes:
        for tick in (t for t in nice_ticks(low[0], high[0]) if low[0] - 1e-12 <= t <= high[0] + 1e-12):
            parts.append(_text("tick", at(tick, 0.0)[0], height - BOTTOM + 18, "middle", text_of(tick, 3)))
        for tick in (t for t in nice_ticks(low[1], high[1], 4) if low[1] - 1e-12 <= t <= high[1] + 1e-12):
            parts.append(_text("tick", at(low[0], 0.0)[0] - 7, at(0.0, tick)[1] + 4, "end", text_of(tick, 3)))
        parts.append(_text("axis-label", left + (WIDTH - left - RIGHT) / 2, height - 6, "middle", scene.x_label))
        upright = _text("axis-label", 0, 0, "middle", scene.y_label)
        parts.append(f'<g transform="translate(13 {TOP + drawn / 2:.0f}) rotate(-90)">{upright}</g>')
    for x, y, label in scene.labels:
        px, py = at(x, y)
        anchor = "start" if px < WIDTH / 3 else "end" if px > 2 * WIDTH / 3 else "middle"
        parts.append(_text("axis-label", px, py, anchor, label))
    name = escape(scene.title, quote=True)
    return f'<svg style="min-width:0" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{name}">{"".join(parts)}</svg>'


def scene_legend(scene: Scene) -> str:
    """Return the swatches of the shapes that have a label, each once."""
    seen: dict[str, int | None] = {}
    for shape in scene.shapes:
        if shape.label:
            seen.setdefault(shape.label, shape.colour)
    items = [
        f'<span><i class="swatch" style="background:{_ink(colour)}"></i>{escape(label)}</span>' for label, colour in seen.items()
    ]
    return f'<div class="legend">{"".join(items)}</div>' if items else ""


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


def _text(kind: str, x: float, y: float, anchor: str, text: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'
