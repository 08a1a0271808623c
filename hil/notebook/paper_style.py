"""The style of figures on paper: ours alone, for a ``matplotlibrc`` of the working folder could run TeX, or be a pipe."""

from __future__ import annotations

from contextlib import AbstractContextManager, chdir
from typing import Any

from hil.errors import HilError

PAPER_STYLE: Any = {
    "font.size": 8, "axes.labelsize": 8, "legend.fontsize": 7, "xtick.labelsize": 7, "ytick.labelsize": 7,
    "lines.linewidth": 1.0, "axes.linewidth": 0.6, "svg.hashsalt": "hilrig", "svg.fonttype": "none", "pdf.fonttype": 42,
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
