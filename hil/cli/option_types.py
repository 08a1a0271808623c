"""Options that commands share, and what a wrong option or value is answered with: what was expected, and the nearest name.

Durations, lists of numbers, quotients, finite numbers, the one that serves Foxglove; and a group of commands.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from hil.errors import nearest
from transport.durations import in_seconds

if TYPE_CHECKING:
    from hil.session import Onlooker


class NamedPath(click.Path):
    """A path that has a name; without one, as where a variable of the shell is not set, ``Path`` would be the working folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not str(value):
            self.fail("the name is empty; is a variable of the shell not set?", param, ctx)
        return super().convert(value, param, ctx)


PATH: Final = NamedPath(path_type=Path)
OUTPUT: Final = NamedPath(path_type=Path, dir_okay=False)


class Questions(click.Group):
    """A command of several: its help has the first sentence of each, whole, below itself where the terminal is narrow."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of the commands."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, each.get_short_help_str(limit=1000)) for name, each in self.commands.items()])


class Duration(click.ParamType[float]):
    """A duration in seconds, as an experiment file writes it.

    Such as ``10``, ``10s`` or ``2 min``.

    Args:
        least: the shortest that is allowed, s.
        most: the longest, s.
        above: whether ``least`` itself is refused.
    """

    name = "TIME"

    def __init__(self, least: float = 0.0, most: float = 1e9, *, above: bool = False) -> None:
        self.least, self.most, self.above = least, most, above

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            seconds = in_seconds(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)
        if not self.least <= seconds <= self.most or (self.above and seconds == self.least):
            first = "above" if self.above else "from"
            self.fail(f"{seconds:g} s, expected a duration {first} {self.least:g} s, at most {self.most:g} s", param, ctx)
        return seconds


MOST = 200
LARGEST: Final = 1e30
"""As in an experiment: products of larger ones leave what a double holds."""


class NumberList(click.ParamType[tuple[float, ...]]):
    """Numbers of at least 0 between commas; with ``whole`` also ranges.

    Such as ``0,1,6`` and ``0..8``.

    Args:
        whole: whole numbers only.
        above: whether 0 itself is refused.
        times: durations, in seconds or with a unit.
    """

    name = "LIST"

    def __init__(self, *, whole: bool = False, above: bool = False, times: bool = False) -> None:
        self.whole, self.above = whole, above
        self._number = int if whole else in_seconds if times else float

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        found: list[float] = []
        for part in str(value).split(","):
            first, dots, last = part.strip().partition("..")
            try:
                if dots and self.whole:
                    found += range(int(first), min(int(last), int(first) + MOST) + 1)
                else:
                    found.append(self._number(part))
                    float(found[-1])  # no number of a list is beyond these
            except (ValueError, OverflowError):
                what = "whole number or range such as 0..8" if self.whole else "number"
                self.fail(f"{part.strip()!r} is no {what}", param, ctx)
        for number in found:
            if not 0 <= number <= LARGEST or (self.above and number == 0):
                most = f" and of at most {LARGEST:g}" if number > LARGEST else ""
                self.fail(f"{number:g}, expected a number {'above' if self.above else 'of at least'} 0{most}", param, ctx)
        if not 1 <= len(found) <= MOST:
            count = f"more than {MOST}" if found else "no"
            self.fail(f"{value:.60}: {count} numbers, expected 1 to {MOST}; a range goes up, such as 0..8", param, ctx)
        return tuple(found)


class Ratio(click.ParamType[tuple[tuple[float, ...], tuple[float, ...]]]):
    """A quotient of polynomials: coefficients between commas, a slash, coefficients; without a slash a polynomial."""

    name = "B/A"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        parts = str(value).split("/")
        try:
            found = [tuple(float(c) for c in part.split(",")) for part in parts]
        except ValueError:
            found = []
        if not 1 <= len(found) <= 2:
            self.fail(f"{value!r}, expected coefficients of 1, 1/z, ... over those below, such as 1,-0.97/1,-0.9", param, ctx)
        return found[0], found[1] if len(found) == 2 else (1.0,)


class Number(click.ParamType):  # type: ignore[type-arg]
    """A finite number of at most 1e30; the help says no range, which no use comes near.

    Args:
        least: the smallest.
    """

    name = "float"

    def __init__(self, least: float = -LARGEST) -> None:
        self.least = least

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            number = float(value)
        except ValueError:
            self.fail(f"{value!r} is not a number", param, ctx)
        if not self.least <= number <= LARGEST:
            self.fail(f"{value}, expected a number from {self.least:g} to {LARGEST:g}", param, ctx)
        return number


class Within(click.FloatRange):
    """A number within bounds; click lets nan through, which is beyond none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is not in the range {self._describe_range()}.", param, ctx)
        return number


foxglove_option = click.option(
    "--foxglove", type=click.IntRange(0, 65535), is_flag=False, flag_value=8765, metavar="[PORT]",
    help="Serve the records to Foxglove or Lichtblick, too, over its WebSocket protocol on 127.0.0.1 (port 8765).",
)  # fmt: skip


@contextmanager
def foxglove_beside(onlooker: Onlooker | None, port: int | None) -> Iterator[Onlooker | None]:
    """Give an onlooker with Foxglove beside it, or it alone where no port is asked for.

    Raises:
        HilError: see `hil.pages.viewers.Foxglove`.
    """
    if port is None:
        yield onlooker
        return
    from hil.pages.viewers import Beside, Foxglove

    with Foxglove(port) as server:
        click.echo(f"Foxglove: open connection {server.url}", err=True)
        yield server if onlooker is None else Beside(onlooker, server)


NOT_A_NUMBER: Final = r"is not (a valid (integer|float)( range)?|in the range .*)\.$"
"""What click says of a value that is no number, or one beyond its bounds."""


def expected(error: click.UsageError) -> str:
    """Return the message for what is no number of its option, or no word of its argument; nothing for another error."""
    if not isinstance(error, click.BadParameter) or error.param is None:
        return ""
    kind, said = error.param.type, error.format_message()
    if isinstance(kind, click.Choice) and isinstance(error.param, click.Argument):  # click would call it by all of its words
        words = ", ".join(map(str, kind.choices))
        if isinstance(error, click.MissingParameter):
            return f"Missing argument: one of {words}."
        return re.sub(r"is not one of .*\.$", f"is not one of {words}.", error.message)
    whole = isinstance(kind, click.types.IntParamType)
    if not (whole or isinstance(kind, click.types.FloatParamType)) or not re.search(NOT_A_NUMBER, said):
        return ""
    bounds = ""
    if isinstance(kind, click.IntRange | click.FloatRange):
        closed = "from" if kind.max is not None else "of at least"
        least = "" if kind.min is None else f" {'above' if kind.min_open else closed} {kind.min:g}"
        most = "" if kind.max is None else f" {'below' if kind.max_open else 'to'} {kind.max:g}"
        bounds = least + most
    return re.sub(NOT_A_NUMBER, f"is not a {'whole ' if whole else ''}number{bounds}.", said)


def near_options(error: click.NoSuchOption) -> list[str]:
    """Return those of click's proposals that are near without their dashes: ``--csv`` does not mean ``--set``."""
    return [name for name in error.possibilities or () if nearest(error.option_name.lstrip("-"), [name.lstrip("-")])]


def suggestion(error: click.UsageError, words: Sequence[str]) -> str:
    """Return a question for the nearest option or value to a word that a command does not take, or nothing.

    Args:
        error: what click says; it asks for the nearest name itself where an option or a command is misspelt.
        words: what was typed behind ``hil``.
    """
    if error.ctx is None:
        return ""
    words = words[len(error.ctx.command_path.split()) - 1 :]  # behind the names of the command
    if isinstance(error, click.BadParameter):
        if error.param is None or not isinstance(error.param.type, click.Choice):
            return ""
        choices = [str(choice) for choice in error.param.type.choices]
        values = [word.partition("=")[2] if word.startswith("--") else word for word in words]
        hints = (nearest(value, choices, lead=" ") for value in values if value not in choices)
        return next(filter(None, hints), "").replace("did", "Did", 1)
    if type(error) is not click.UsageError:
        return ""
    options = [option for each in error.ctx.command.params if isinstance(each, click.Option) for option in each.opts]
    for before, word in zip(("", *words), words):
        key, equals, _ = word.partition("=")
        if equals and not before.startswith("-") and not word.startswith("-"):
            return nearest(f"--{key}", options) or (f"; did you mean '--set {word}'?" if "--set" in options else "")
    return ""
