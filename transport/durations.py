"""Durations as they are written in a file or typed: ``0.05``, ``50 ms``, ``25ms``, ``1.5 h``."""

from __future__ import annotations

import re
from typing import Final

UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_NUMBER: Final = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
PATTERN: Final = rf"^\s*{_NUMBER}\s*(?:{'|'.join(UNITS)})?\s*$"
"""Of the text of a duration, for a JSON Schema too."""

_SHAPE: Final = re.compile(rf"({_NUMBER})\s*([a-z]*)")


def in_seconds(text: str) -> float:
    """Return a duration in seconds; it may overflow to infinity.

    Args:
        text: a number, and a unit or none (seconds), with or without a space between them.

    Raises:
        ValueError: it is none.

    >>> in_seconds("25ms"), in_seconds("25 ms"), in_seconds("2min"), in_seconds("3"), in_seconds("1e2s")
    (0.025, 0.025, 120.0, 3.0, 100.0)
    """
    found = _SHAPE.fullmatch(text.strip())
    if found is None or (found[2] or "s") not in UNITS:
        raise ValueError(f"{text!r:.60} is not a duration: expected a number and one of {', '.join(UNITS)}, as in 25ms or 1.5 h")
    return float(found[1]) * UNITS[found[2] or "s"]
