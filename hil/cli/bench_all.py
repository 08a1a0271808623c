"""``hil bench all``: every figure with its peer, their ratio and its goal; ``hil bench page``: the guide's page of them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click


@click.command(name="all")
@click.option("--only", multiple=True, metavar="NAME", help="Only this part, several allowed: start, sweeps, real-time, ...")
@click.option("--quick", is_flag=True, help="Measure smaller things, some seconds a part; nothing is judged.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def everything(only: tuple[str, ...], quick: bool, as_json: bool) -> None:
    """Every figure with its peer, their ratio, and whether it reaches its goal; takes a quarter of an hour on two quiet CPUs.

    What a machine lacks (cyclictest, dask) is said in the row that needs it. Ctrl-C prints what was measured until then.
    """
    from hil.bench.run_parts import chosen, run_parts

    found, interrupt = run_parts(chosen(only), lambda text: click.echo(text, err=True), quick=quick)
    if as_json:
        print(json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        _show(found)
    if interrupt is not None:
        raise interrupt


def _show(found: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from hil.bench.page import HEADS, cells, machine_line, remark

    table = Table(title=machine_line(found))
    for i, head in enumerate(HEADS):
        table.add_column(head, justify="right" if 0 < i < 4 else "left")
    part = None
    for row in found["figures"]:
        if part not in (None, row["part"]):
            table.add_section()
        part = row["part"]
        table.add_row(*map(escape, cells(row)))
    console = Console()
    if not console.is_terminal:
        console.width = 200  # a file has no edge to wrap at
    console.print(table)
    for row in found["figures"]:
        console.print(remark(row), markup=False, highlight=False)


@click.command()
@click.argument("figures", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), metavar="PAGE.md", help="File [stdout].")
def page(figures: Path, output: Path | None) -> None:
    """Make a page of FIGURES, what `hil bench all --json` has printed, with the machine and the date: in Markdown."""
    from hil.bench.page import page_of
    from hil.cli.outputs import check_output, write_output
    from hil.errors import HilError

    if output is not None:
        check_output(output)
    try:
        text = page_of(json.loads(figures.read_text(encoding="utf-8")))
    except (ValueError, KeyError, TypeError) as error:
        raise HilError(f"{figures}: not what `hil bench all --json` prints: {type(error).__name__}: {error}") from None
    if output is None:
        sys.stdout.write(text)
    else:
        write_output(output, text)
