"""What a notebook shows of a result: one line, its answer in sentences, a table and a plot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.errors import HilError
from hil.notebook.sheet import as_svg, drawn

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Cell = str | float | int | None
SIDE = 'style="text-align:{side};padding:2px 10px"'


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
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

    def html(self) -> str:
        """Return the cell: the line, the answer, the table, and the plot where matplotlib is installed."""
        said = "".join(f"<p><b>{escape(sentence)}</b></p>" for sentence in self.answer)
        heads = "".join(f"<th {SIDE.format(side=_side(self.rows, i))}>{escape(c)}</th>" for i, c in enumerate(self.columns))
        body = "".join(
            "<tr>" + "".join(f"<td {SIDE.format(side=_side(self.rows, i))}>{_text(v)}</td>" for i, v in enumerate(row)) + "</tr>"
            for row in self.rows
        )
        table = f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>" if self.rows else ""
        return f"<div><p>{escape(self.line)}</p>{said}{table}{as_svg(self.paint) if self.paint else ''}</div>"

    def plot(self, path: str | Path | None, width_mm: float, height_mm: float) -> Figure:
        """Return the plot, and write it to a file; see `hil.notebook.sheet.drawn`.

        Raises:
            HilError: there is none, or it cannot be drawn or written.
        """
        if self.paint is None:
            raise HilError("plot: there is nothing to draw")
        return drawn(self.paint, path, width_mm, height_mm)


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
    return escape(value) if isinstance(value, str) else f"{value:.5g}" if isinstance(value, float) else str(value)


def _side(rows: Sequence[Sequence[Cell]], column: int) -> str:
    """Words stand at the left of their column, numbers at the right."""
    return "left" if any(isinstance(row[column], str) for row in rows) else "right"
