"""Tables on a terminal: a number is never cut, however narrow it is."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table


def print_table(table: Table) -> None:
    """Print a table as wide as its content needs, also where that is wider than the terminal or a pipe's 80 columns.

    A line that the terminal folds can be read; ``1.3081e-…`` cannot.
    """
    console = Console()
    needed = console.measure(table, options=console.options.update(max_width=10_000)).maximum
    Console(width=max(console.width, needed)).print(table)
