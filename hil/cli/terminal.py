"""Text on a terminal: strings of others shown as what they are, tables, names in two columns, one JSON value.

What would move the cursor or colour a line is shown and not obeyed; a number in a table is never cut, however narrow the
terminal. Two columns come without rich, whose import is a tenth of a short run. With ``--json`` standard output holds one JSON
value, whatever a plug-in prints meanwhile.
"""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from shutil import get_terminal_size
from textwrap import wrap
from typing import TYPE_CHECKING, Final

import click

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text


LONGEST: Final = 2000
"""Bytes of a message, all of its lines together."""

_UNSEEN: Final = ("Cc", "Cf", "Cs", "Co", "Zl", "Zp")  # control, direction and other invisible, half characters, line ends


def visible(text: object) -> str:
    r"""Return a text with its control characters escaped.

    Args:
        text: anything; its `str` is taken.

    >>> visible("a\x1b[2Jb")
    'a\\x1b[2Jb'
    """
    found = str(text)
    if found.isprintable():
        return found
    return "".join(c.encode("unicode_escape").decode() if unicodedata.category(c) in _UNSEEN else c for c in found)


def message_lines(text: str) -> list[str]:
    """Return the lines of a message, escaped, in at most `LONGEST` bytes; what was left out is counted.

    Args:
        text: one fault a line.
    """
    lines = text.split("\n")
    kept: list[str] = []
    left = LONGEST - 40
    for line in lines:
        shown = visible(line)
        size = len(shown.encode()) + 6  # "hil: " and the line's end
        if size > left:
            if not kept:
                kept.append(shown.encode()[: max(left - 10, 0)].decode(errors="ignore") + " ...")
            break
        kept.append(shown)
        left -= size
    if len(kept) < len(lines):
        kept.append(f"... and {len(lines) - len(kept)} more of these")
    return kept


def cell(value: object, style: str = "") -> Text:
    """Return a table's cell that shows a text as it is: escaped, and without markup.

    Args:
        value: anything; its `str` is taken.
        style: of rich.
    """
    from rich.text import Text

    return Text(visible(value), style=style)


def print_facts(facts: Iterable[tuple[str, str, str]]) -> None:
    """Print facts, one a line: name, value, remark."""
    for name, value, remark in facts:
        click.echo(f"{name:>22}  {value:<12} {remark}".rstrip())


def print_table(table: Table) -> None:
    """Print a table as wide as its content needs, also where that is wider than the terminal or a pipe's 80 columns.

    A line that the terminal folds can be read; ``1.3081e-…`` cannot.
    """
    from rich.console import Console

    console = Console()
    needed = console.measure(table, options=console.options.update(max_width=10_000)).maximum
    Console(width=max(console.width, needed)).print(table)


GAP = 2  # blanks between the columns
NARROWEST = 10  # characters of the second column, however narrow the terminal is


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A name and its value.

    Args:
        name, value: as they are; what would move the cursor is shown escaped.
        colour: of the value, as click knows it; None for the terminal's own.
        coloured: how much of the value has it, in characters from its begin; None for all of it.
    """

    name: str
    value: str
    colour: str | None = None
    coloured: int | None = None


def print_lines(lines: Sequence[Line]) -> None:
    """Print two columns as wide as the terminal, 80 where there is none; a value goes on below itself, no word is cut that fits.

    Args:
        lines: in this order.
    """
    width = max((len(visible(line.name)) for line in lines), default=0)
    room = max(get_terminal_size().columns - width - GAP, NARROWEST)
    shown = []
    for line in lines:
        name = visible(line.name)
        parts = wrap(visible(line.value), room, break_on_hyphens=False) or [""]
        for i, part in enumerate(parts):
            first = click.style(name, bold=True) + " " * (width - len(name)) if i == 0 else " " * width
            shown.append(first + " " * GAP + _painted(part, line, i))
    click.echo("\n".join(shown), color=False if os.environ.get("NO_COLOR") else None)


def _painted(part: str, line: Line, number: int) -> str:
    if line.colour is None:
        return part
    if line.coloured is None:
        return click.style(part, fg=line.colour)
    return click.style(part[: line.coloured], fg=line.colour) + part[line.coloured :] if number == 0 else part
