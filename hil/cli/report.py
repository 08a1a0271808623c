"""``hil report``: a self-contained page from a log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hil.errors import HilError


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="PAGE.html", help="Page to write, FILE.html by default.")
@click.option("--open", "show", is_flag=True, help="Open the page in the browser.")
def command(file: Path, output: Path | None, show: bool) -> None:
    """Make one self-contained HTML page from the log FILE: it needs no network and no other file.

    An existing page is replaced; the log is never changed.
    """
    from hil.cli.outputs import check_output, write_output
    from hil.cli.terminal import visible
    from hil.log.read.run import read_run
    from hil.measure.summary import summarise
    from hil.measure.view import view_of
    from hil.report.run.prediction import theory_section
    from hil.report.run.run_page import render_report
    from hil.report.run.wall_section import wall_section

    run = read_run(file)
    target = output or file.with_suffix(".html")
    if target.resolve() == file.resolve():
        raise HilError(f"{target}: is the log itself; choose another -o")
    check_output(target, page=True)
    view = view_of(run)
    found = (wall_section(view), theory_section(view))
    said: dict[str, Any] = {name: run.summary[name] for name in ("problems", "log") if name in run.summary}
    page = render_report(view, {**summarise(view), **said}, sections=[section for section in found if section])
    write_output(target, page)
    click.echo(f"written: {visible(target)} ({len(page.encode()) / 1e6:.1f} MB)")
    if show:
        click.launch(str(target))
