"""Lists of numbers on the command line: ``0,1,6`` and ``0..8``."""

from __future__ import annotations

import math

import click

from transport.durations import in_seconds

MOST = 200


class NumberList(click.ParamType[tuple[float, ...]]):
    """Numbers between commas; with ``whole`` also ranges.

    Args:
        whole: whole numbers only.
        least: smallest number that is allowed.
        above: whether ``least`` itself is refused.
        times: durations, in seconds or with a unit.
    """

    name = "LIST"

    def __init__(self, *, whole: bool = False, least: float = 0.0, above: bool = False, times: bool = False) -> None:
        self.whole, self.least, self.above = whole, least, above
        self._number = int if whole else in_seconds if times else float

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
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
            if not math.isfinite(number) or number < self.least or (self.above and number == self.least):
                self.fail(f"{number:g}, expected a number {'above' if self.above else 'of at least'} {self.least:g}", param, ctx)
        if not 1 <= len(found) <= MOST:
            self.fail(f"{len(found)} numbers, expected 1 to {MOST}", param, ctx)
        return tuple(found)
