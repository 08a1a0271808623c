"""Text on a terminal: strings of others shown as what they are, names in two columns, one JSON value.

What would move the cursor or colour a line is shown and not obeyed. Two columns come without rich, whose import is a tenth of a
short run. With ``--json`` standard output holds one JSON value, whatever a plug-in prints meanwhile.
"""

from __future__ import annotations

import io
import json
import os
import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from textwrap import fill, wrap
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TextIO, TypeVar

import click

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console
    from rich.progress import Progress

LONGEST: Final = 2000
"""Bytes of a message, all of its lines together."""

_UNSEEN: Final = ("Cc", "Cf", "Cs", "Co", "Zl", "Zp")  # control, direction and other invisible, half characters, line ends


def visible(text: object) -> str:
    r"""Return a text with its control characters escaped.

    Args:
        text: anything; its `str` is taken.

    >>> visible("a\x1b[2Jb")
    'a\\x1b[2Jb'
    """
    found = str(text)
    if found.isprintable():
        return found
    return "".join(c.encode("unicode_escape").decode() if unicodedata.category(c) in _UNSEEN else c for c in found)


def message_lines(text: str) -> list[str]:
    """Return the lines of a message, escaped, in at most `LONGEST` bytes; what was left out is counted.

    Args:
        text: one fault a line.
    """
    lines = text.split("\n")
    kept: list[str] = []
    left = LONGEST - 40
    for line in lines:
        shown = visible(line)
        size = len(shown.encode()) + 6  # "hil: " and the line's end
        if size > left:
            if not kept:
                kept.append(shown.encode()[: max(left - 10, 0)].decode(errors="ignore") + " ...")
            break
        kept.append(shown)
        left -= size
    if len(kept) < len(lines):
        kept.append(f"... and {len(lines) - len(kept)} more of these")
    return kept


def print_facts(facts: Iterable[tuple[str, str, str]]) -> None:
    """Print facts, one a line: name, value, remark."""
    print_lines([Line(name, f"{value:<12} {remark}".rstrip()) for name, value, remark in facts])


def print_folded(text: str, indent: str = "") -> None:
    """Print a paragraph as wide as the terminal; no word is cut, so that a path is copied whole.

    Args:
        text: one line; the blanks before it stay.
        indent: of the lines below the first.
    """
    if text:
        shown = fill(visible(text), terminal_columns(), subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
        click.echo(shown)


def print_written(*paths: Path | None) -> None:
    """Print the name of each file that was written, one a line."""
    for path in filter(None, paths):
        click.echo(f"written: {visible(path)}")


def print_each_folded(lines: Iterable[str]) -> None:
    """Print each line as wide as the terminal; what it has no room for goes on below, two blanks in."""
    for line in lines:
        print_folded(line, "  ")


GAP = 2  # blanks between the columns
NARROWEST = 12  # characters of a column of words, however narrow the terminal is


class Line(NamedTuple):
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


def console() -> Console:
    """Return rich's console of standard output; with NO_COLOR it writes no escape code, of bold neither."""
    from rich.console import Console

    class Piped(Console):
        def on_broken_pipe(self) -> None:  # rich would exit with 1
            raise BrokenPipeError

    return Piped(color_system=None) if os.environ.get("NO_COLOR") else Piped()


def terminal_columns() -> int:
    """Return how wide the terminal is, as `shutil` says it: COLUMNS, else asked, else 80; its import is 1 % of a short run."""
    with suppress(KeyError, ValueError):
        if (columns := int(os.environ["COLUMNS"])) > 0:
            return columns
    with suppress(AttributeError, ValueError, OSError):  # standard output may be closed, or no terminal
        return os.get_terminal_size(sys.__stdout__.fileno()).columns or 80  # type: ignore[union-attr]
    return 80


def print_lines(lines: Sequence[Line]) -> None:
    """Print two columns as wide as the terminal, 80 where there is none; a value goes on below itself, no word is cut that fits.

    Args:
        lines: in this order.
    """
    width = max((len(visible(line.name)) for line in lines), default=0)
    room = max(terminal_columns() - width - GAP, NARROWEST)
    shown = []
    for line in lines:
        name = visible(line.name)
        parts = wrap(visible(line.value), room, break_on_hyphens=False) or [""]
        for i, part in enumerate(parts):
            first = click.style(name, bold=True) + " " * (width - len(name)) if i == 0 else " " * width
            shown.append(first + " " * GAP + _painted(part, line, i))
    click.echo("\n".join(shown))


def _painted(part: str, line: Line, number: int) -> str:
    if line.colour is None:
        return part
    if line.coloured is None:
        return click.style(part, fg=line.colour)
    return click.style(part[: line.coloured], fg=line.colour) + part[line.coloured :] if number == 0 else part


class Working:
    """A line on a terminal's standard error from here to the end of the block; in a pipe or a CI log one every `EVERY_S` seconds.

    On a terminal nothing may be printed inside the block, and no other picture drawn.

    Args:
        title: what is computed.
        total: how many there are to do, where that is known; then the line says how long they still take.
    """

    EVERY_S = 10.0

    def __init__(self, title: str, total: int | None = None) -> None:
        self._title, self._total = visible(title), total
        self._said, self._shown, self._share = self._title, ("", -1), 0.0
        self._bar: Progress | None = None
        self._task: Any = None
        self._done = Event()
        self._teller: Thread | None = None

    def __enter__(self) -> Working:
        if sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

            time = TimeElapsedColumn() if self._total is None else TimeRemainingColumn()
            words = TextColumn("{task.description}", markup=False)
            self._bar = Progress(words, BarColumn(), time, console=Console(stderr=True), transient=True)
            self._bar.start()
            self._task = self._bar.add_task(self._title, total=self._total)
        elif sys.stderr is not None:
            self._teller = Thread(target=self._tell, daemon=True)
            self._teller.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
        if self._teller is not None:
            self._done.set()
            self._teller.join()

    def __call__(self, stage: str, done: int, total: int, value: float) -> None:
        """Show how far a design is, and the norm that it has reached."""
        self._say(f"{self._title}: {stage} norm {value:.6g}", done, total)

    def counted(self, done: int, total: int | None = None, what: str = "") -> None:
        """Show how many are done, of what, a hundred times in all: the line takes milliseconds."""
        total = total or self._total or 1
        shown = what, 100 * done // total
        if shown != self._shown:
            self._shown, self._share = shown, done / total
            title = f"{self._title}, {visible(what)}" if what else self._title
            self._say(f"{title}: {done} of {total}", done, total)

    def _say(self, said: str, done: int, total: int) -> None:
        self._said = said
        if self._bar is not None:
            self._bar.update(self._task, description=said, completed=done, total=total)

    def _tell(self) -> None:
        lasted = 0.0
        while not self._done.wait(self.EVERY_S):
            lasted += self.EVERY_S
            left = f", about {lasted * (1.0 / self._share - 1.0):.0f} s left" if 0.0 < self._share < 1.0 else ""
            with suppress(OSError, ValueError):  # nobody reads it any more
                print(f"hil: {self._said} ({lasted:.0f} s{left})", file=sys.stderr, flush=True)


_OUT: Final = "hil.cli.terminal"
_Command = TypeVar("_Command", bound=Callable[..., Any])


def json_option(help: str = "Print one JSON object.") -> Callable[[_Command], _Command]:
    """Return the option `--json` of a command, which `answer` heeds; what else is printed goes to standard error.

    Args:
        help: what ``--help`` says of it.
    """
    return click.option("--json", "as_json", is_flag=True, is_eager=True, expose_value=False, callback=_only_json, help=help)


def wants_json() -> bool:
    """Return whether the command that runs was asked for JSON."""
    return _OUT in click.get_current_context().meta


def answer(value: object, show: Callable[..., object], *arguments: object) -> None:
    """Print what a command found: its one JSON value where `--json` asks for it, else words for people.

    Args:
        value: as JSON has it.
        show: prints the words.
        arguments: of `show`.
    """
    if wants_json():
        print_json(value)
    else:
        show(*arguments)


def print_json(value: object) -> None:
    """Print the one JSON value of a command."""
    out = click.get_current_context().meta.get(_OUT, sys.stdout)
    print(json.dumps(value, indent=2), file=out, flush=True)


def _only_json(context: click.Context, _option: click.Parameter, as_json: bool) -> None:
    if as_json and not context.resilient_parsing:
        context.meta[_OUT] = context.with_resource(_stdout_to_stderr())


@contextmanager
def _stdout_to_stderr() -> Iterator[TextIO]:
    """Yield where standard output went until now; for so long it goes to standard error, the descriptor too."""
    out = sys.stdout
    with open(os.devnull, "w") as nowhere, redirect_stdout(sys.stderr or nowhere):
        if not _is_descriptor(out, 1):  # a test or a notebook took its place
            yield out
            return
        kept = os.dup(1)
        os.dup2(2 if _is_descriptor(sys.stderr, 2) else nowhere.fileno(), 1)
        try:
            with open(kept, "w", encoding=out.encoding, errors=out.errors, closefd=False) as file:
                yield file
        finally:
            with suppress(OSError):
                os.dup2(kept, 1)
            with suppress(OSError):
                os.close(kept)


def _is_descriptor(stream: TextIO | None, number: int) -> bool:
    try:
        return stream is not None and stream.fileno() == number
    except (io.UnsupportedOperation, ValueError):  # no file, or closed
        return False
