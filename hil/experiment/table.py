"""What every table of an experiment file is made of: fields that are checked, and durations with a unit."""

from __future__ import annotations

import math
import typing
from typing import Any

import msgspec

from transport.durations import in_seconds

LONGEST_S = 6e9  # 1e8 slots of 60 s; in nanoseconds it still is a number of 64 bits


class Seconds(float):
    """A duration: a bare number in seconds or a string with a unit, ``"50 ms"`` or ``"50ms"``."""

    @classmethod
    def parse(cls, value: object) -> Seconds:
        """Return the duration in seconds.

        >>> Seconds.parse("50 ms"), Seconds.parse(2)
        (0.05, 2.0)
        """
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"expected a duration such as '50 ms' or 0.05, got {value!r:.60}")
        if not isinstance(value, str):
            seconds = float(value) if isinstance(value, float) or value.bit_length() <= 64 else math.inf
        else:
            seconds = in_seconds(value)
        if not math.isfinite(seconds):
            raise ValueError(f"{value!r:.60} is not a finite number of seconds")
        return cls(seconds)


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every table of an experiment file.

    ``faults(values)`` checks the fields that could be converted, whether or not the others could.
    """

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        """Yield ``field: what is wrong``."""
        yield from ()


def not_negative(values: typing.Mapping[str, Any], field: str) -> typing.Iterator[str]:
    """Yield what is wrong with a time that is negative, or longer than a run can be."""
    if values.get(field, 0.0) < 0:
        yield f"{field}: {values[field]:g} s is negative"
    elif values.get(field, 0.0) > LONGEST_S:
        yield f"{field}: {values[field]:g} s is above {LONGEST_S:g} s"
