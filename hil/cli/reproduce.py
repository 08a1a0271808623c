"""``hil reproduce``: a chapter's numbers and figures, printed beside computed, with a verdict per row."""

from __future__ import annotations

import json
import textwrap
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
    from hil.cli.outputs import check_output, write_output
    from hil.reproduce import chapters, reproduce

    if chapter not in chapters():
        raise click.UsageError(f"{chapter!r} is not one of {', '.join(chapters())}")
    if output is not None:
        check_output(output, page=True)  # now, and not after the work
    result = reproduce(chapter, lambda text: click.echo(text, err=True))
    if output is not None:
        write_output(output, result.page())
        click.echo(f"figures: {output}", err=True)
    if as_json:
        print(json.dumps(result.to_json(), indent=2))
        return
    colours = {"reproduced": "green", "not reproduced": "yellow", "claim false": "red"}
    click.secho(result.title, bold=True)
    for row in result.rows:
        click.echo(f"\n{click.style(row.verdict, fg=colours[row.verdict], bold=True)}: {row.item}")
        for name, text in (("printed", row.printed), ("computed", row.computed), ("basis", row.basis)):
            if text:
                click.echo(
                    textwrap.fill(f"{name:9} {text}", width=110, initial_indent="    ", subsequent_indent=" " * 14)
                )
    counts = ", ".join(f"{sum(row.verdict == verdict for row in result.rows)} {verdict}" for verdict in colours)
    click.echo(f"\n{len(result.rows)} rows: {counts}")
