"""A figure of matplotlib in the size in which it is printed, and its file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.errors import HilError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.notebook.paper_figure import PaperFigure

MM_PER_INCH = 25.4
FORMATS = (".svg", ".pdf", ".png")
PAPER_STYLE: Any = {
    "font.size": 8, "axes.labelsize": 8, "legend.fontsize": 7, "xtick.labelsize": 7, "ytick.labelsize": 7,
    "lines.linewidth": 1.0, "axes.linewidth": 0.6, "svg.hashsalt": "hilrig", "svg.fonttype": "none", "pdf.fonttype": 42,
}  # fmt: skip
"""What matplotlib is told for a figure that is printed in a column."""


def drawn(paint: Callable[[Figure], None], path: str | Path | None, width_mm: float, height_mm: float) -> PaperFigure:
    """Return a figure, and write it to a file where one is asked for.

    Args:
        paint: puts axes and lines into the figure.
        path: where to write it; its ending says how: .svg, .pdf or .png (300 dots per inch).
        width_mm, height_mm: of the figure as it is printed; 85 mm is a column of many journals.

    Raises:
        HilError: if matplotlib is not installed, or for another ending or size.
    """
    try:
        from matplotlib import rc_context

        from hil.notebook.paper_figure import PaperFigure
    except ImportError as error:
        raise HilError("plot: matplotlib is not installed; pip install 'hilrig[notebook]'") from error
    if path is not None and Path(path).suffix not in FORMATS:
        raise HilError(f"plot: {str(path)!r}; expected a name that ends in {', '.join(FORMATS)}")
    if not (10.0 <= width_mm <= 2000.0 and 10.0 <= height_mm <= 2000.0):
        raise HilError(f"plot: {width_mm:g} mm x {height_mm:g} mm; expected 10 to 2000 mm")
    with rc_context(PAPER_STYLE):
        sheet = PaperFigure(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH), layout="constrained")
        paint(sheet)
        if path is not None:
            metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(Path(path).suffix)
            sheet.savefig(path, dpi=300, metadata=metadata)
    return sheet


def as_svg(paint: Callable[[Figure], None], width_mm: float = 160.0, height_mm: float = 90.0) -> str:
    """Return a figure as the element ``<svg>`` of a cell, nothing where matplotlib is not installed."""
    try:
        return drawn(paint, None, width_mm, height_mm).svg()
    except HilError:
        return ""
