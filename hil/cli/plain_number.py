"""A number as an option takes it: finite, and of a size that an experiment takes, too."""

from __future__ import annotations

from typing import Any, Final

import click

LARGEST: Final = 1e30
"""As in an experiment: products of larger ones leave what a double holds."""


class Number(click.ParamType):  # type: ignore[type-arg]
    """A finite number of at most 1e30; the help says no range, which nobody comes near."""

    name = "float"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            number = float(value)
        except ValueError:
            self.fail(f"{value!r} is not a number", param, ctx)
        if abs(number) > LARGEST:  # what is no number is for the command to say
            self.fail(f"{value}, expected a number of at most {LARGEST:g}", param, ctx)
        return number
