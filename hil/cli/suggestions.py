"""What a misspelt word of the command line was meant to be: ``gird=1``, ``plant.gain=3`` without ``--set``, ``--clock reel``."""

from __future__ import annotations

from collections.abc import Sequence

import click

from hil.errors import nearest


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
