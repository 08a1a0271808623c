"""Names and what they stand for, in two columns on a terminal: without rich, whose import is a tenth of a short run."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from shutil import get_terminal_size
from textwrap import wrap

import click

from hil.cli.terminal import visible

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
