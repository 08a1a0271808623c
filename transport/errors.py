"""A parameter of a law that does not fit, and what is not known of a law. Faults of links are in `transport.links`."""

from __future__ import annotations

from collections.abc import Iterable


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


class NotKnown(Exception):
    """What was asked of a network is not known; its text is the reason, a phrase."""


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that one comes near to, None if none does.

    >>> nearest("cann", ["can", "zenoh"]), nearest("x", ["can"])
    ('can', None)
    """
    from difflib import get_close_matches  # who makes no mistake needs none

    return next(iter(get_close_matches(name, [*known], n=1)), None)
