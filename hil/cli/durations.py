"""Durations on the command line: ``10``, ``10s``, ``2 min``."""

from __future__ import annotations

import click

from transport.durations import in_seconds


class Duration(click.ParamType[float]):
    """A duration in seconds, as an experiment file writes it.

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
            seconds = float(value) if isinstance(value, int | float) else in_seconds(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)
        if not self.least <= seconds <= self.most or (self.above and seconds == self.least):
            first = "above" if self.above else "from"
            self.fail(f"{seconds:g} s, expected a duration {first} {self.least:g} s, at most {self.most:g} s", param, ctx)
        return seconds
