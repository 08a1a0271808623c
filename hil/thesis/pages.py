"""Pages of what was reproduced: one per chapter, and an index that leads to them; and what its rules can tell.

That is the share of the reproduced rows that turn when every computed number is 10 % larger, and smaller. A row that claims an
equality turns both ways, or its check would have been undecided (`hil.thesis.judgement`). A one-sided claim need not: how far
its number lies from the limit is no part of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec.structs import replace

from hil.pages import Badge, Cell, Link, Section, State, Table, Text, Tile
from hil.pages.html.page import Page
from hil.thesis import Reproduction
from hil.thesis.judgement import OFF, VERDICTS, Kind, Row, Verdict

KINDS: tuple[Kind, ...] = ("equality", "one run", "one-sided")
"""What a row with numbers claims: the first of these that one of its checks is."""


def turns(row: Row, share: float) -> bool:
    """Return whether the verdict is another one when every computed number of the row is this share larger."""
    checks = tuple(check.off(share) or check for check in row.checks)
    return replace(row, checks=checks).verdict != row.verdict


def power(rows: Iterable[Row], share: float = OFF) -> dict[str, tuple[int, int]]:
    """Return by kind how many reproduced rows turn both ways, and how many there are; rows of words are left out."""
    found: dict[str, tuple[int, int]] = dict.fromkeys(KINDS, (0, 0))
    for row in rows:
        kind = next((kind for kind in KINDS if kind in row.kinds), None)
        if kind is not None and row.verdict == "reproduced":
            turned, of = found[kind]
            found[kind] = (turned + (turns(row, share) and turns(row, -share)), of + 1)
    return found


def power_in_words(rows: Iterable[Row]) -> str:
    """Return `power` as a sentence."""
    found = power(rows)
    kinds = ", ".join(f"{turned} of {of} {kind}" for kind, (turned, of) in found.items())
    turned, of = (sum(each) for each in zip(*found.values()))
    return f"every number {OFF:.0%} larger or smaller turns {turned} of {of} reproduced rows with numbers: {kinds}"


STATES: dict[Verdict, State] = dict(zip(VERDICTS, ("good", "warning", "bad", "neutral"), strict=True))
KICKER = "hilrig · reproduce"
HOW = (
    "Every number is computed when this page is made, and every verdict follows from the numbers of its row by the rule "
    "beside it, whose kind says what it can decide: an equality, one run among ours, a one-sided claim, a word. A verdict "
    "belongs to the assumption in the last column of its chapter's page."
)


def chapter_page(result: Reproduction) -> str:
    """One self-contained HTML page: the table, then every figure."""
    cells = [(*_first(r), r.printed, r.computed, r.rule, r.basis) for r in result.rows]
    columns = ("item", "verdict", "printed", "computed", "rule", "assumption or witness")  # a phone shows two
    numbers = (Text(text=HOW), Text(text=_power(result.rows)), Table(columns=columns, rows=cells))
    sections = [Section(title="Numbers", blocks=numbers)]
    for plot in result.figures:
        columns_wide = min(2, len(plot.panels))
        sections.append(Section(title=plot.title, blocks=plot.panels, intro=plot.intro, columns=columns_wide))
    tiles = [Tile(label=v, value=result.counts[v], state=STATES[v]) for v in VERDICTS]
    return Page(result.title, sections, kicker=KICKER, tiles=tiles).html()


def index_page(results: Mapping[str, Reproduction]) -> str:
    """Everything in one page: the count of each verdict by chapter, with a link to its page, and the rule of every row."""
    rows: list[tuple[Cell, ...]] = [
        (Link(label=result.title, href=f"{name}.html"), len(result.rows), *(result.counts[v] for v in VERDICTS))
        for name, result in results.items()
    ]
    table = Table(columns=("chapter", "rows", *VERDICTS), rows=rows)
    tiles = [Tile(label=v, value=sum(r.counts[v] for r in results.values()), state=STATES[v]) for v in VERDICTS]
    every_row = [row for result in results.values() for row in result.rows]
    section = Section(title="Chapters", blocks=(Text(text=HOW), Text(text=_power(every_row)), table))
    sections = [section]
    for result in results.values():
        cells = [(*_first(r), r.printed, r.computed, r.rule) for r in result.rows]
        every = Table(columns=("item", "verdict", "printed", "computed", "rule"), rows=cells)
        sections.append(Section(title=result.title, blocks=(every,)))
    return Page("The thesis beside correct computations", sections, kicker=KICKER, tiles=tiles).html()


def _first(row: Row) -> tuple[str, Badge]:
    return row.item, Badge(label=row.verdict, state=STATES[row.verdict])


def _power(rows: Sequence[Row]) -> str:
    return f"What the rules can tell: {power_in_words(rows)}."
