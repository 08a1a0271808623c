"""A figure of matplotlib that a notebook shows: of matplotlib's own it shows only those that pyplot made."""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class PaperFigure(Figure):
    """A figure, and the element ``<svg>`` that a cell shows of it."""

    def svg(self) -> str:
        """Return the element ``<svg>``."""
        picture = io.StringIO()
        self.savefig(picture, format="svg", metadata={"Date": None})
        text = picture.getvalue()
        return text[text.find("<svg") :]

    def _repr_svg_(self) -> str:
        return self.svg()
