"""``hil reproduce``: a chapter's numbers and figures, printed beside computed, with a verdict per row."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.option_types import PATH
from hil.cli.terminal import Working, json_option, print_json, terminal_columns, wants_json

if TYPE_CHECKING:
    from hil.thesis import Reproduction, Step
    from hil.thesis.checkpoint import KeptStages
    from hil.thesis.judgement import Row

ALL = "all"
STATE = "reproduce.state"
COLOURS = ("green", "yellow", "red", "blue")
WIDEST = 110
"""Columns of a line that are still read with ease."""


@click.command()
@click.argument("chapter")
@json_option("Print one JSON object; for all, one per chapter by its name.")
@click.option("-o", "--output", type=PATH, help="Write the page with the figures here; for all, a folder.")
@click.option("--power", "with_power", is_flag=True, help="Also say how many verdicts change if a number is 10 % off.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
def command(chapter: str, output: Path | None, with_power: bool, force: bool) -> None:
    """Reproduce CHAPTER of the thesis (ch2, ch3, ch4, ch5, ch6, ch7), or all: every number, and with -o every figure.

    The rule beside each row decides its verdict from its numbers, and says what kind of claim it is. With -o what is finished
    is kept in a file beside the page (reproduce.state in the folder of all, PAGE.state for one) until everything is: after
    Ctrl-C the same command goes on from there.
    """
    from hil.files import write_output
    from hil.thesis import chapters, compute_chapter, seconds_left
    from hil.thesis.checkpoint import KeptStages
    from hil.thesis.pages import chapter_page, index_page, power, power_in_words

    if chapter not in (*chapters(), ALL):
        raise click.UsageError(f"{chapter!r} is not one of {', '.join((*chapters(), ALL))}")
    as_json = wants_json()
    names = chapters() if chapter == ALL else (chapter,)
    pages = {} if output is None else _pages(chapter, names, output, force)  # now, and not after the work
    results = {}
    with ExitStack() as stack:
        state = None if output is None else output / STATE if chapter == ALL else output.with_name(output.name + ".state")
        kept = None if state is None else stack.enter_context(KeptStages(state))
        if kept is not None and kept.stages:
            click.echo(f"goes on: {_stages(kept)} in {state}", err=True)
        stack.push(partial(_interrupted, kept))
        nominal_s = [seconds_left(name, kept) for name in names]
        watch = stack.enter_context(Working("reproduce", max(round(sum(nominal_s)), 1)))
        for i, name in enumerate(names):
            results[name] = compute_chapter(name, partial(_show_step, watch, name, sum(nominal_s[:i])), kept)
            if output is not None:
                write_output(pages[name], chapter_page(results[name]))
                click.echo(f"figures: {pages[name]}", err=True)
            if not as_json:
                _show(results[name])
        if chapter == ALL and not as_json:
            _show_counts([row for result in results.values() for row in result.rows])
        if with_power and not as_json:
            click.echo(_folded(power_in_words([row for result in results.values() for row in result.rows])))
        if chapter == ALL and output is not None:
            write_output(pages[ALL], index_page(results))
            click.echo(f"index: {pages[ALL]}", err=True)
        if kept is not None:
            kept.done()
    if as_json:
        found: dict[str, Any] = {name: result.to_json() for name, result in results.items()}
        if with_power:
            found = {name: {**each, "power": power(results[name].rows)} for name, each in found.items()}
        print_json(found if chapter == ALL else found[chapter])


def _show_step(watch: Working, chapter: str, before_s: float, step: Step) -> None:
    """Say which step runs; how far all is, is counted in nominal seconds, so that the rest is estimated by the pace so far."""
    words = f"{chapter} {step.number}/{step.stages} {step.stage}" + (f": {step.text}" if step.text else "")
    watch.counted(round(before_s + step.seconds), what=words)


def _stages(kept: KeptStages) -> str:
    return "1 stage is" if len(kept.stages) == 1 else f"{len(kept.stages)} stages are"


def _interrupted(kept: KeptStages | None, kind: type[BaseException] | None, *_: object) -> None:
    """Say after Ctrl-C what is kept, where something is."""
    if kind is not None and issubclass(kind, KeyboardInterrupt) and kept is not None and kept.stages:
        click.echo(f"the same command goes on: {_stages(kept)} in {kept.path}", err=True)


def _pages(chapter: str, names: tuple[str, ...], output: Path, force: bool) -> dict[str, Path]:
    """Where each page goes, checked. The folder of ``all`` is made; an ``index.html`` of another kind is refused."""
    from hil.errors import located
    from hil.files import check_page

    pages = {chapter: output}
    if chapter == ALL:
        with located(f"{output}: cannot be made a folder", OSError):
            output.mkdir(exist_ok=True)
        pages = {**{name: output / f"{name}.html" for name in names}, ALL: output / "index.html"}
    for path in pages.values():
        check_page(path, force=force)
    return pages


def _show(result: Reproduction) -> None:
    from hil.thesis.judgement import VERDICTS

    colours = dict(zip(VERDICTS, COLOURS, strict=True))
    click.secho(result.title, bold=True)
    for row in result.rows:
        item = _folded(f"{row.verdict}: {row.item}", "  ")
        click.echo("\n" + click.style(row.verdict, fg=colours[row.verdict], bold=True) + item[len(row.verdict) :])
        for name, text in (("printed", row.printed), ("computed", row.computed), ("rule", row.rule), ("basis", row.basis)):
            if text:
                click.echo(_folded(f"    {name:9} {text}", " " * 14))
    click.echo()
    _show_counts(result.rows)


def _show_counts(rows: Sequence[Row]) -> None:
    from hil.thesis.judgement import VERDICTS

    counts = ", ".join(f"{sum(row.verdict == verdict for row in rows)} {verdict}" for verdict in VERDICTS)
    click.echo(_folded(f"{len(rows)} rows: {counts}") + "\n")


def _folded(text: str, indent: str = "") -> str:
    """Fold a paragraph at the columns of the terminal, at most `WIDEST`."""
    return textwrap.fill(text, min(terminal_columns(), WIDEST), subsequent_indent=indent, break_on_hyphens=False)
