"""``hil reproduce``: a chapter's numbers and figures, printed beside computed, with a verdict per row."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command()
@click.argument("chapter")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Write the page with the figures here."
)
def command(chapter: str, as_json: bool, output: Path | None) -> None:
    """Reproduce CHAPTER of the thesis (ch2, ch3, ch4, ch7): every number, and with -o every figure on one page."""
    from hil.reproduce import chapters, reproduce

    if chapter not in chapters():
        raise click.UsageError(f"{chapter!r} is not one of {', '.join(chapters())}")
    result = reproduce(chapter, lambda text: click.echo(text, err=True))
    if output is not None:
        output.write_text(result.page(), encoding="utf-8")
        click.echo(f"figures: {output}", err=True)
    if as_json:
        print(json.dumps(result.to_json(), indent=2))
        return
    from rich.console import Console
    from rich.table import Table

    colours = {"reproduced": "green", "not reproduced": "yellow", "claim false": "red"}
    table = Table(title=result.title, show_lines=True)
    for head in ("item", "printed", "computed", "verdict", "assumption or witness"):
        table.add_column(head, overflow="fold")
    for row in result.rows:
        verdict = f"[{colours[row.verdict]}]{row.verdict}[/]"
        table.add_row(
            *(text.replace("[", "\\[") for text in (row.item, row.printed, row.computed)),
            verdict,
            row.basis.replace("[", "\\["),
        )
    Console().print(table)
