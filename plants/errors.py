"""The one error root of the package, and checks of parameters: each raises ValueError that begins with the path of the field.

The loader of an experiment puts the place of the plant in front of it, so that a reader is led to the line:
``plant.friction.static_v: 0.001, expected at least coulomb_v (0.0017)``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final


class PlantError(Exception):
    """A plant was asked for something that its equations cannot give (the message names the object and the value)."""


class FieldError(ValueError):
    """A value that does not fit, with the field that holds it; its text is ``field: message``.

    Args:
        field: the parameter, or the path to it: ``latency.file``, ``sojourn[2]``.
        message: what is wrong: the value, what was expected.
    """

    def __init__(self, field: str, message: str) -> None:
        super().__init__(field, message)
        self.field, self.message = field, message

    def __str__(self) -> str:
        return f"{self.field}: {self.message}"


SHORTEST_STEP_S: Final = 1e-5
"""What changes more often than every 10 us would take a run longer than it lasts."""

LONGEST_STEP_S: Final = 1e9
"""The clock of a run holds no longer time."""


def require_finite(path: str, value: float) -> None:
    """Refuse NaN and infinity.

    >>> require_finite("gain", float("nan"))
    Traceback (most recent call last):
    plants.errors.FieldError: gain: nan, expected a finite number
    """
    if not math.isfinite(value):
        raise FieldError(path, f"{value!r}, expected a finite number")


def require_positive(path: str, value: float) -> None:
    """Refuse everything but a finite number above 0."""
    if not (math.isfinite(value) and value > 0):
        raise FieldError(path, f"{value!r}, expected a finite number > 0")


def require_step(path: str, value: float) -> None:
    """Refuse everything but a time between two changes that a rig can follow, in s."""
    if not SHORTEST_STEP_S <= value <= LONGEST_STEP_S:
        limit = f"at most {LONGEST_STEP_S:g} s" if value > LONGEST_STEP_S else f"at least {SHORTEST_STEP_S:g} s"
        raise FieldError(path, f"{value!r} s, expected {limit}")


def require_not_negative(path: str, value: float) -> None:
    """Refuse everything but a finite number of at least 0."""
    if not (math.isfinite(value) and value >= 0):
        raise FieldError(path, f"{value!r}, expected a finite number >= 0")


def require_time_span(start_s: float, stop_s: float | None) -> None:
    """Refuse a span that begins before 0, or that does not end after its start; None is no end."""
    require_not_negative("start_s", start_s)
    if stop_s is not None and not (math.isfinite(stop_s) and stop_s > start_s):
        raise FieldError("stop_s", f"{stop_s!r}, expected a finite number above start_s ({start_s!r})")


def require_vector(path: str, value: Sequence[float], length: int) -> None:
    """Refuse a vector of the wrong length or with an entry that is not finite."""
    if len(value) != length:
        raise FieldError(path, f"{len(value)} entries, expected {length}")
    for i, entry in enumerate(value):
        require_finite(f"{path}[{i}]", entry)


def require_rows(path: str, rows: Sequence[Sequence[float]]) -> None:
    """Refuse a matrix without rows, or with rows of several lengths."""
    if len({len(row) for row in rows}) != 1:
        raise FieldError(path, "expected rows of one length, and at least one")


def require_whole_nanoseconds(path: str, seconds: float) -> None:
    """Refuse a time between two changes that is too short, or no whole number of nanoseconds (events live on that grid)."""
    require_step(path, seconds)
    nanoseconds = seconds * 1e9
    if abs(nanoseconds - round(nanoseconds)) > 1e-6 * nanoseconds:
        raise FieldError(path, f"{seconds!r} s, expected a whole number of nanoseconds")


def require_choice(path: str, value: str, choices: Sequence[str]) -> None:
    """Refuse a word that is not one of the choices."""
    if value not in choices:
        raise FieldError(path, f"{value!r}, expected one of {', '.join(choices)}")
