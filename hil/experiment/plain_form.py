"""Values of an experiment as plain JSON values, for its resolved form."""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy as np

from hil.experiment.table import Seconds
from hil.experiment.unavailable_plugin import UnavailablePlugin


def plain(value: Any) -> Any:
    """Return a value of an experiment as JSON has it: numbers, text, lists and tables; an object of another kind by its class."""
    if isinstance(value, UnavailablePlugin):
        return dict(value.said)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
    if isinstance(value, msgspec.Struct):
        config = value.__struct_config__
        tag = {config.tag_field: config.tag} if config.tag_field else {}
        names = zip(value.__struct_encode_fields__, value.__struct_fields__)
        return tag | {key: plain(getattr(value, f)) for key, f in names}
    if isinstance(value, tuple | list):
        return [plain(v) for v in value]
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if value is None or isinstance(value, str | int | float):
        return float(value) if isinstance(value, Seconds) else value
    return f"{type(value).__module__}.{type(value).__qualname__}"  # of an object that was built in Python
