"""Results in a notebook and in a paper: tables of pandas, figures of matplotlib, and the cells that show them.

A result of many runs, of a design or of a chapter is shown as one line, its answer in sentences, a table and a plot; a figure is
printed in millimetres.
"""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, chdir
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from hil.errors import HilError, located

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


MM_PER_INCH = 25.4
FORMATS = (".svg", ".pdf", ".png")


def drawn(paint: Callable[[Figure], None], path: str | Path | None, width_mm: float, height_mm: float) -> Figure:
    """Return a figure, and write it to a file where one is asked for.

    Args:
        paint: puts axes and lines into the figure.
        path: where to write it; its ending says how: .svg, .pdf or .png (300 dots per inch).
        width_mm, height_mm: of the figure as it is printed; 85 mm is a column of many journals.

    Raises:
        HilError: if matplotlib is not installed, for another ending or size, or if the file cannot be written.
    """
    context = paper_style("plot")
    from matplotlib.figure import Figure

    class PaperFigure(Figure):  # of matplotlib's own a notebook shows only those that pyplot made
        _repr_svg_ = svg_of

    if path is not None and Path(str(path)).suffix not in FORMATS:
        raise HilError(f"plot: {str(path)!r}; expected a name that ends in {', '.join(FORMATS)}")
    if not all(isinstance(size, Real) and 10.0 <= size <= 2000.0 for size in (width_mm, height_mm)):
        raise HilError(f"plot: {width_mm!r:.20} mm x {height_mm!r:.20} mm; expected 10 to 2000 mm")
    with context:
        sheet = PaperFigure(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH), layout="constrained")
        paint(sheet)
        if path is not None:
            metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(Path(path).suffix)
            with located(f"plot: {path}: cannot be written", OSError):
                sheet.savefig(path, dpi=300, metadata=metadata)
    return sheet


def literal(text: str) -> str:
    r"""Return a text that matplotlib draws as it is: in one from elsewhere a dollar sign begins no formula.

    >>> literal("$/h")
    '\\$/h'
    """
    return text.encode("utf-8", "backslashreplace").decode().replace("$", r"\$")


def svg_of(sheet: Figure) -> str:
    """Return the element ``<svg>`` of a figure, as a cell shows it."""
    picture = io.StringIO()
    sheet.savefig(picture, format="svg", metadata={"Date": None})
    text = picture.getvalue()
    return text[text.find("<svg") :]


def as_svg(paint: Callable[[Figure], None], height_mm: float) -> str:
    """Return a figure as the element ``<svg>`` of a cell, nothing where matplotlib is not installed."""
    try:
        return svg_of(drawn(paint, None, 160.0, height_mm))
    except HilError:
        return ""


Cell = str | float | int | None
SIDE = "text-align:{side};padding:2px 10px"
WHOLE = 26
"""Characters of a cell that stay on one line: a number with its exponent, an interval, a name."""


class Result(Struct, frozen=True, kw_only=True):
    """What is shown of a result.

    Args:
        line: the result in one line.
        answer: what it says, in sentences.
        columns: heads of the table.
        rows: of the table; None is shown as a dash.
        paint: puts the plot into a figure of matplotlib; None where there is none.
    """

    line: str
    answer: Sequence[str] = ()
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[Cell]] = ()
    paint: Callable[[Figure], None] | None = None

    def html(self, height_mm: float = 90.0) -> str:
        """Return the cell: the line, the answer, the table, and the plot, so high, where matplotlib is installed."""
        from html import escape  # its table of names is large

        said = "".join(f"<p><b>{escape(sentence)}</b></p>" for sentence in self.answer)
        words = [any(isinstance(row[i], str) for row in self.rows) for i in range(len(self.columns))]
        sides = [SIDE.format(side="left" if of_words else "right") for of_words in words]
        heads = "".join(f'<th style="{side}">{escape(head)}</th>' for side, head in zip(sides, self.columns))
        body = "".join("<tr>" + "".join(map(_cell, sides, row)) + "</tr>" for row in self.rows)
        table = f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>" if self.rows else ""
        return f"<div><p>{escape(self.line)}</p>{said}{table}{as_svg(self.paint, height_mm) if self.paint else ''}</div>"

    def plot(self, path: str | Path | None, width_mm: float, height_mm: float) -> Figure:
        """Return the plot, and write it to a file; see `hil.notebook.drawn`.

        Raises:
            HilError: there is none, or it cannot be drawn or written.
        """
        if self.paint is None:
            raise HilError("plot: there is nothing to draw")
        return drawn(self.paint, path, width_mm, height_mm)


class SingleResult(ABC):
    """What is shown as one thing: a subclass says what that is by `_result`."""

    __slots__ = ()

    @abstractmethod
    def _result(self) -> Result: ...

    def plot(self, path: str | Path | None = None, *, width_mm: float = 85.0, height_mm: float = 70.0) -> Figure:
        """Draw it; write the figure to a file where one is named.

        Args:
            path: ends in .svg, .pdf or .png.
            width_mm, height_mm: of the figure as it is printed.

        Raises:
            HilError: the figure cannot be drawn or written.
        """
        return self._result().plot(path, width_mm, height_mm)

    def _repr_html_(self) -> str:
        return self._result().html()


def data_frame(columns: Mapping[str, Any], units: Mapping[str, str] | None = None) -> pandas.DataFrame:
    """Return columns, one entry each per row, as a table of pandas, with the units in ``attrs``.

    Raises:
        HilError: if pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise HilError("to_pandas: pandas is not installed; pip install 'hilrig[notebook]'") from error
    frame = pandas.DataFrame(dict(columns))
    frame.attrs["units"] = dict(units or {})
    return frame


def _text(value: Cell) -> str:
    if value is None or value != value:
        return "-"
    from html import escape

    return escape(value) if isinstance(value, str) else f"{value:.5g}" if isinstance(value, float) else str(value)


def _cell(side: str, value: Cell) -> str:
    text = _text(value)
    return f'<td style="{side}{";white-space:nowrap" if len(text) <= WHOLE else ""}">{text}</td>'


PAPER_STYLE: Any = {
    "font.size": 8, "axes.labelsize": 8, "legend.fontsize": 7, "legend.edgecolor": "none", "xtick.labelsize": 7,
    "ytick.labelsize": 7, "lines.linewidth": 1.0, "axes.linewidth": 0.6,
    "svg.hashsalt": "hilrig", "svg.fonttype": "none", "pdf.fonttype": 42,
}  # fmt: skip
"""The style of matplotlib for a figure that is printed in a column."""


def paper_style(asked: str) -> AbstractContextManager[None]:
    """Return the context in which figures are drawn: matplotlib's own defaults, and `PAPER_STYLE`.

    Args:
        asked: what needs matplotlib, for the message.

    Raises:
        HilError: if matplotlib is not installed.
    """
    try:
        with chdir("/"):  # matplotlib reads the file when it is imported for the first time
            from matplotlib import style
    except ImportError as error:
        raise HilError(f"{asked}: matplotlib is not installed; pip install 'hilrig[notebook]'") from error
    context: AbstractContextManager[None] = style.context([PAPER_STYLE], after_reset=True)
    return context
