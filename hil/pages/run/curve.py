"""A curve of a run, made from its records block by block: a page of a long run holds no more than it draws."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.log.append_column import ROWS, pieces
from hil.measure.view import seconds
from hil.pages.html.decimation import Float, reduced
from hil.pages.html.figures import LineStyle, Series

Records: TypeAlias = npt.NDArray[np.void]
All: TypeAlias = Callable[[Records], npt.NDArray[np.bool_]]


def curve(
    records: Records,
    y: str | Callable[[Records], npt.NDArray[Any]],
    *,
    label: str,
    style: LineStyle = "line",
    where: All | None = None,
    x: Callable[[Records], Float] = seconds,
    **look: Any,
) -> Series:
    """Return a curve over session time.

    Args:
        records: of a topic.
        y: a field, or what to draw of some records.
        label, style: of the curve.
        where: which of some records are drawn; all by default.
        x: where they are drawn; at their session time by default.
        look: `colour`, `halo`, `faint` of the curve.
    """
    def blocks() -> Iterator[tuple[Float, Float]]:
        for piece in pieces(records):
            own = piece if where is None else piece[where(piece)]
            yield x(own), np.asarray(own[y] if isinstance(y, str) else y(own), dtype=np.float64)

    return _series(blocks, label, style, look)


def curve_of(x: Float, y: Float, *, label: str, style: LineStyle = "line", **look: Any) -> Series:
    """Return a curve of two arrays (n,), reduced to what a page draws.

    Args:
        x: does not decrease.
        y: with NaN for gaps.
        label, style: of the curve.
        look: `colour`, `halo`, `faint` of the curve.
    """
    def blocks() -> Iterator[tuple[Float, Float]]:
        for i in range(0, len(x), ROWS):
            yield np.asarray(x[i : i + ROWS], dtype=np.float64), np.asarray(y[i : i + ROWS], dtype=np.float64)

    return _series(blocks, label, style, look)


def _series(blocks: Callable[[], Iterator[tuple[Float, Float]]], label: str, style: LineStyle, look: dict[str, Any]) -> Series:
    x, y, samples = reduced(blocks, step="step" in style)
    return Series(label=label, x=x, y=y, style=style, samples=samples, **look)
