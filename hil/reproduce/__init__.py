"""The thesis's numbers beside computed ones: one module per chapter, each with ``reproduce(progress) -> Reproduction``.

A row says what is printed, what comes out, a verdict, and the assumption or the witness that the verdict rests on.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Literal

from hil.report.html.figures import Bars, Figure, Histogram, Section, State, Table, Text

Verdict = Literal["reproduced", "not reproduced", "claim false"]
Progress = Callable[[str], None]
STATES: dict[Verdict, State] = {"reproduced": "good", "not reproduced": "warning", "claim false": "bad"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One number or claim of a chapter.

    Args:
        item: where it stands and what it is.
        printed: as printed ("-" where the text gives none).
        computed: what came out.
        verdict: ``reproduced``, ``not reproduced`` or ``claim false``.
        basis: the assumption that was needed, or the witness.
    """

    item: str
    printed: str
    computed: str
    verdict: Verdict
    basis: str = ""


def row(item: str, printed: str, computed: str, verdict: Verdict, basis: str = "") -> Row:
    """A row, written as it is read: item, printed, computed, verdict, assumption or witness."""
    return Row(item=item, printed=printed, computed=computed, verdict=verdict, basis=basis)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plot:
    """One figure of a chapter: its number there, and the panels that show it."""

    title: str
    panels: tuple[Figure | Bars | Histogram, ...]
    intro: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """Everything of one chapter."""

    title: str
    rows: tuple[Row, ...]
    figures: tuple[Plot, ...] = ()

    def to_json(self) -> dict[str, object]:
        """Title, rows and a count per verdict, as a dictionary that ``json.dumps`` takes."""
        counts = {verdict: sum(row.verdict == verdict for row in self.rows) for verdict in STATES}
        return {"title": self.title, "rows": [asdict(row) for row in self.rows], "counts": counts}

    def page(self) -> str:
        """One self-contained HTML page: the table, then every figure."""
        from hil.report.html.figures import Badge, Tile
        from hil.report.html.page import render_page

        cells = [
            (r.item, r.printed, r.computed, Badge(label=r.verdict, state=STATES[r.verdict]), r.basis) for r in self.rows
        ]
        table = Table(columns=("item", "printed", "computed", "verdict", "assumption or witness"), rows=cells)
        how = Text(
            text="Every number is computed when this page is made. A verdict belongs to the assumption beside it."
        )
        sections = [Section(title="Numbers", blocks=(how, table))]
        for plot in self.figures:
            columns = min(2, len(plot.panels))
            sections.append(Section(title=plot.title, blocks=plot.panels, intro=plot.intro, columns=columns))
        tiles = [Tile(label=v, value=sum(r.verdict == v for r in self.rows), state=STATES[v]) for v in STATES]
        return render_page(self.title, sections, kicker="hilrig · reproduce", tiles=tiles)


def chapters() -> tuple[str, ...]:
    """Names of the chapters that can be reproduced, e.g. ``("ch2", "ch3")``."""
    rooms = (info.name for info in pkgutil.iter_modules(__path__))
    return tuple(sorted(f"ch{room.removeprefix('chapter')}" for room in rooms if room.startswith("chapter")))


def reproduce(chapter: str, progress: Progress = lambda text: None) -> Reproduction:
    """Compute a chapter. Raises KeyError if it is not one of ``chapters()``."""
    if chapter not in chapters():
        raise KeyError(chapter)
    room = importlib.import_module(f"hil.reproduce.chapter{chapter.removeprefix('ch')}.numbers")
    result: Reproduction = room.reproduce(progress)
    return result
