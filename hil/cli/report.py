"""``hil report``: a self-contained page from a log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hil.errors import HilError


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="PAGE.html", help="Page to write, FILE.html by default.")
@click.option("--figures", type=click.Path(path_type=Path), metavar="DIR", help="Also write every plot as SVG and PDF.")
@click.option("--open", "show", is_flag=True, help="Open the page in the browser.")
def command(file: Path, output: Path | None, figures: Path | None, show: bool) -> None:
    """Make one self-contained HTML page from the log FILE: it needs no network and no other file.

    An existing page is replaced; the log is never changed.
    """
    from hil.cli.outputs import check_output, write_output
    from hil.cli.terminal import visible
    from hil.log.read.run import read_run
    from hil.measure.summary import summarise
    from hil.measure.view import view_of
    from hil.pages.run.prediction import theory_section
    from hil.pages.run.run_page import render_report
    from hil.pages.run.wall_section import wall_section

    run = read_run(file)
    target = output or file.with_suffix(".html")
    if target.resolve() == file.resolve():
        raise HilError(f"{target} is the log itself; choose another -o")
    check_output(target, page=True)
    view = view_of(run)
    found = (wall_section(view), theory_section(view))
    said: dict[str, Any] = {name: run.summary[name] for name in ("problems", "log") if name in run.summary}
    summary = {**summarise(view), **said}
    further = [section for section in found if section]
    page = render_report(view, summary, sections=further)
    write_output(target, page)
    click.echo(f"written: {visible(target)} ({len(page.encode()) / 1e6:.1f} MB)")
    if figures is not None:
        from hil.pages.paper import write_figures
        from hil.pages.run.run_page import run_sections

        drawn = write_figures([*run_sections(view, summary, {}), *further], figures)
        click.echo(f"written: {len(drawn)} figures in {visible(figures)}")
    if show:
        click.launch(str(target))
