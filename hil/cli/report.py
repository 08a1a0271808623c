"""``hil report``: a self-contained page from a log, or from a folder of logs."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.terminal import Working, visible


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="PAGE.html", help="Page to write, FILE.html by default.")
@click.option("--figures", type=click.Path(path_type=Path), metavar="DIR", help="Also write every plot as SVG and PDF.")
@click.option("--folder", type=click.Path(path_type=Path), metavar="DIR", help="Where own modules stand: they are run.")
@click.option("--open", "show", is_flag=True, help="Open the page in the browser.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
def command(file: Path, output: Path | None, figures: Path | None, folder: Path | None, show: bool, force: bool) -> None:
    """Make one self-contained HTML page from the log FILE: it needs no network and no other file.

    Where FILE is a folder, its page (index.html) lists all its logs, with a filter and their outputs; each gets its own page.

    A page that is there is replaced; the log is never changed.
    """
    from hil.api.face import report

    with Working(f"page of {file}"):
        page, *drawn = report(file, output=output, force=force, figures=figures, folder=folder)
    click.echo(f"written: {visible(page)} ({page.stat().st_size / 1e6:.1f} MB)")
    if file.is_dir():
        click.echo(f"written: {len(drawn)} page{'s' * (len(drawn) != 1)} of runs beside it")
    if figures is not None:
        click.echo(f"written: {len(drawn)} figures in {visible(figures)}")
    if show:
        click.launch(str(page))
