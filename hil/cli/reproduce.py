"""``hil reproduce``: a chapter's numbers and figures, printed beside computed, with a verdict per row."""

from __future__ import annotations

import json
import sys
import textwrap
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from hil.reproduce import Reproduction, Step

ALL = "all"
COLOURS = ("green", "yellow", "red", "blue")


@click.command()
@click.argument("chapter")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object; for all, one per chapter by its name.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Write the page with the figures here; for all, a folder."
)
def command(chapter: str, as_json: bool, output: Path | None) -> None:
    """Reproduce CHAPTER of the thesis (ch2, ch3, ch4, ch5, ch6, ch7), or all: every number, and with -o every figure.

    A verdict follows from the numbers of its row by the rule that stands with it.
    """
    from hil.cli.outputs import write_output
    from hil.reproduce import chapters, reproduce
    from hil.reproduce.pages import chapter_page, index_page

    if chapter not in (*chapters(), ALL):
        raise click.UsageError(f"{chapter!r} is not one of {', '.join((*chapters(), ALL))}")
    names = chapters() if chapter == ALL else (chapter,)
    pages = _pages(chapter, names, output)  # now, and not after the work
    results = {}
    for name in names:
        with _Progress(name) as progress:
            results[name] = reproduce(name, progress)
        if output is not None:
            write_output(pages[name], chapter_page(results[name]))
            click.echo(f"figures: {pages[name]}", err=True)
        if not as_json:
            _show(results[name])
    if chapter == ALL and output is not None:
        write_output(pages[ALL], index_page(results))
        click.echo(f"index: {pages[ALL]}", err=True)
    if as_json:
        found: dict[str, Any] = {name: result.to_json() for name, result in results.items()}
        print(json.dumps(found if chapter == ALL else found[chapter], indent=2))


def _pages(chapter: str, names: tuple[str, ...], output: Path | None) -> dict[str, Path]:
    """Where each page goes, checked. The folder of ``all`` is made; an ``index.html`` of another kind is refused."""
    from hil.cli.outputs import check_output
    from hil.errors import HilError

    if output is None:
        return {}
    if chapter != ALL:
        return {chapter: check_output(output, page=True)}
    try:
        output.mkdir(exist_ok=True)
    except OSError as error:
        raise HilError(f"{output}: cannot be made a folder: {(error.strerror or str(error)).lower()}") from error
    pages = {**{name: output / f"{name}.html" for name in names}, ALL: output / "index.html"}
    return {name: check_output(path, page=True) for name, path in pages.items()}


def _show(result: Reproduction) -> None:
    from hil.reproduce import VERDICTS

    colours = dict(zip(VERDICTS, COLOURS, strict=True))
    click.secho(result.title, bold=True)
    for row in result.rows:
        click.echo(f"\n{click.style(row.verdict, fg=colours[row.verdict], bold=True)}: {row.item}")
        for name, text in (("printed", row.printed), ("computed", row.computed), ("rule", row.rule), ("basis", row.basis)):
            if text:
                click.echo(
                    textwrap.fill(f"{name:9} {text}", width=110, initial_indent="    ", subsequent_indent=" " * 14)
                )
    counts = ", ".join(f"{count} {verdict}" for verdict, count in result.counts.items())
    click.echo(f"\n{len(result.rows)} rows: {counts}\n")


class _Progress:
    """Stages and the steps inside them: a bar on a terminal, a line per new word elsewhere; on standard error."""

    def __init__(self, chapter: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        console = Console(stderr=True)
        self._terminal = console.is_terminal
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=console, disable=not self._terminal, transient=True)
        self._chapter, self._task = chapter, self._bar.add_task(chapter, total=None)
        self._last = ""

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def __call__(self, step: Step) -> None:
        words = f"{self._chapter} {step.number}/{step.stages} {step.stage}" + (f": {step.text}" if step.text else "")
        part = step.done / step.total if step.total else 0.0
        self._bar.update(self._task, description=words, completed=step.number - 1 + part, total=step.stages)
        if not self._terminal and words != self._last:
            print(words, file=sys.stderr, flush=True)
        self._last = words
