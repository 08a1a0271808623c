"""What a wrong option or value is answered with: what was expected, and the nearest name that there is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import click

from hil.errors import nearest

NOT_A_NUMBER: Final = re.compile(r"is not (a valid (integer|float)( range)?|in the range .*)\.$")
"""What click says of a value that is no number, or one beyond its bounds."""


def expected(error: click.UsageError) -> str:
    """Return the message for a value that is no number of its option, with what was expected; nothing for another error."""
    if not isinstance(error, click.BadParameter) or error.param is None:
        return ""
    kind, said = error.param.type, error.format_message()
    whole = isinstance(kind, click.types.IntParamType)
    if not (whole or isinstance(kind, click.types.FloatParamType)) or not NOT_A_NUMBER.search(said):
        return ""
    bounds = ""
    if isinstance(kind, click.IntRange | click.FloatRange):
        closed = "from" if kind.max is not None else "of at least"
        least = "" if kind.min is None else f" {'above' if kind.min_open else closed} {kind.min:g}"
        most = "" if kind.max is None else f" {'below' if kind.max_open else 'to'} {kind.max:g}"
        bounds = least + most
    return NOT_A_NUMBER.sub(f"is not a {'whole ' if whole else ''}number{bounds}.", said)


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
