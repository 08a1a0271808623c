"""What a stage found as plain JSON and back: only the classes listed here are ever made from a file."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from hil.pages.html.figures import Band, BarGroup, Bars, Figure, Histogram, Marker, Series
from hil.reproduce.chapter import Part, Plot
from hil.reproduce.judgement import Approximately, Between, Check, Drawn, Equals, Row, Untold

CLASSES: dict[str, Any] = {
    kind.__name__: kind
    for kind in (
        Part, Plot, Row, Check, Approximately, Between, Drawn, Equals, Untold,
        Figure, Series, Band, Marker, Bars, BarGroup, Histogram,
    )
}
KINDS = {"f": np.float64, "i": np.int64, "b": np.bool_}


def as_plain(value: Any) -> Any:
    """A value of a part as dictionaries, lists, numbers and words.

    Raises:
        TypeError: for a value of a class that is not listed.
    """
    if isinstance(value, np.ndarray) and value.dtype.kind in KINDS:
        return {"array": value.dtype.kind, "values": value.tolist()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple):
        return {"tuple": [as_plain(each) for each in value]}
    if isinstance(value, list):
        return [as_plain(each) for each in value]
    if value is None or isinstance(value, str | int | float):
        return value
    name = type(value).__name__
    if CLASSES.get(name) is not type(value):
        raise TypeError(f"{name} cannot be kept")
    return {"is": name, "has": {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}}


def from_plain(plain: Any) -> Any:
    """What `as_plain` was given.

    Raises:
        ValueError, KeyError, TypeError, AttributeError: if it is nothing that `as_plain` gives.
    """
    if isinstance(plain, list):
        return [from_plain(each) for each in plain]
    if not isinstance(plain, dict):
        return plain
    if "array" in plain:
        return np.array(plain["values"], dtype=KINDS[plain["array"]])
    if "tuple" in plain:
        return tuple(from_plain(each) for each in plain["tuple"])
    return CLASSES[plain["is"]](**{name: from_plain(each) for name, each in plain["has"].items()})
