"""Pages of what was reproduced: one per chapter, and an index that leads to them."""

from __future__ import annotations

from collections.abc import Mapping

from hil.report.html.figures import Badge, Cell, Link, Section, State, Table, Text, Tile
from hil.report.html.page import render_page
from hil.reproduce.chapter import Reproduction
from hil.reproduce.judgement import VERDICTS, Verdict

STATES: dict[Verdict, State] = dict(zip(VERDICTS, ("good", "warning", "bad", "neutral"), strict=True))
KICKER = "hilrig · reproduce"
HOW = (
    "Every number is computed when this page is made, and every verdict follows from the numbers of its row by the rule "
    "beside it. A verdict belongs to the assumption in the last column."
)


def chapter_page(result: Reproduction) -> str:
    """One self-contained HTML page: the table, then every figure."""
    cells = [
        (r.item, Badge(label=r.verdict, state=STATES[r.verdict]), r.printed, r.computed, r.rule, r.basis) for r in result.rows
    ]
    columns = ("item", "verdict", "printed", "computed", "rule", "assumption or witness")  # a phone shows two
    sections = [Section(title="Numbers", blocks=(Text(text=HOW), Table(columns=columns, rows=cells)))]
    for plot in result.figures:
        columns_wide = min(2, len(plot.panels))
        sections.append(Section(title=plot.title, blocks=plot.panels, intro=plot.intro, columns=columns_wide))
    tiles = [Tile(label=v, value=result.counts[v], state=STATES[v]) for v in VERDICTS]
    return render_page(result.title, sections, kicker=KICKER, tiles=tiles)


def index_page(results: Mapping[str, Reproduction]) -> str:
    """The page that leads to ``CHAPTER.html`` of every chapter, with the count of each verdict."""
    rows: list[tuple[Cell, ...]] = [
        (Link(label=result.title, href=f"{name}.html"), len(result.rows), *(result.counts[v] for v in VERDICTS))
        for name, result in results.items()
    ]
    table = Table(columns=("chapter", "rows", *VERDICTS), rows=rows)
    tiles = [Tile(label=v, value=sum(r.counts[v] for r in results.values()), state=STATES[v]) for v in VERDICTS]
    section = Section(title="Chapters", blocks=(Text(text=HOW), table))
    return render_page("The thesis beside correct computations", [section], kicker=KICKER, tiles=tiles)
