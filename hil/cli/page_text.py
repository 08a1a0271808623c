"""A page and its tables as text on a terminal: what `hil.pages` draws is printed in the same words, without its figures.

A number in a table is never cut, however narrow the terminal.
"""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import fill, wrap
from typing import TYPE_CHECKING, Final

import click

from hil.cli.terminal import NARROWEST, answer, console, print_folded, terminal_columns, visible

if TYPE_CHECKING:
    from rich.text import Text

    from hil.pages.html.figures import Cell, Table
    from hil.pages.html.page import Page


_NUMBER: Final = re.compile(r"[-+−–.\d][^:,]*$|none$")  # what a cell is that stands right in its column
_STYLES: Final = {"bad": "red", "warning": "yellow"}


def print_table(table: Table, *, folds: bool = False) -> None:
    """Print a table of a page as wide as its content needs, also where that is wider than the terminal or a pipe's 80 columns.

    A line that the terminal folds can be read; ``1.3081e-…`` cannot. Columns of numbers stand right.

    Args:
        table: what is printed.
        folds: words may go on below themselves where the terminal is narrow, numbers never.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Column
    from rich.table import Table as Shown
    from rich.text import Text

    if table.title:  # rich would fold it at the columns of a narrow table
        click.secho(fill(visible(table.title), terminal_columns()), bold=True)
    shown = Shown(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    rows = [[_shown(value) for value in row] for row in table.rows]
    folding: list[tuple[int, Column]] = []
    for head, column in zip(table.columns, zip(*rows) if rows else [()] * len(table.columns)):
        longest = max((len(one.plain) for one in column), default=0)
        if all(_NUMBER.match(one.plain) or not one.plain for one in column):
            lines = wrap(visible(head), max(longest, *map(len, head.split(" ")), 1))  # no wider than its numbers
            shown.add_column(Text("\n".join(lines)), justify="right", no_wrap=True)
        else:
            shown.add_column(Text(visible(head)), overflow="fold")
            folding.append((max(longest, len(visible(head))), shown.columns[-1]))
    for i, row in enumerate(rows):
        shown.add_row(*row, style="bold" if i in table.highlight else "")
    out = console()
    whole = out.options.update(max_width=10_000)
    excess = out.measure(shown, options=whole).maximum - out.width if folds else 0
    if excess > sum(max(natural - NARROWEST, 0) for natural, _ in folding):  # one blank between columns then
        shown.padding = 0
        excess = out.measure(shown, options=whole).maximum - out.width
    for natural, words in sorted(folding, key=lambda each: -each[0]):  # rich would narrow one below its least, and crop it
        words.width = max(natural - max(excess, 0), min(natural, NARROWEST))
        excess -= natural - words.width
    out.width = max(out.width, out.measure(shown, options=whole).maximum)
    out.print(shown)
    print_folded(table.note)


def _shown(value: Cell) -> Text:
    """Return a table's cell that shows a text as it is: escaped, and without markup."""
    from rich.text import Text

    from hil.pages.html.figures import Badge
    from hil.pages.html.numbers import text_of

    if isinstance(value, Badge):
        return Text(visible(value.label), style=_STYLES.get(value.state, ""))
    return Text(visible(text_of(value, 6) if isinstance(value, float) else text_of(value)))


def print_page(page: Page) -> None:
    """Print what a page says without its figures: title, facts, verdicts, tables and paragraphs."""
    from hil.pages.html.figures import Table, Text

    click.secho(visible(page.title), bold=True)
    print_folded(page.subtitle)
    print_folded(", ".join(f"{name} {value}" for name, value in page.facts))
    for badge in page.badges:
        print_folded(badge.label)
    for section in page.sections:
        click.secho(f"\n{visible(section.title)}", bold=True)
        for block in section.blocks:
            if isinstance(block, Table):
                print_table(block, folds=True)
            elif isinstance(block, Text) and not block.code:
                print_folded(block.text)


def show_page(page: Page, document: object, path: Path | None) -> None:
    """Write a page where a path is given; print it without its figures, or as JSON.

    Args:
        page: the answer.
        document: the same as JSON values.
        path: of the page; None: none is written.

    Raises:
        HilError: the file cannot be written.
    """
    from hil.files import write_output

    if path is not None:
        write_output(path, page.html())
    answer(document, print_page, page)
