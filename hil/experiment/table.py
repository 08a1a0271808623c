"""What every table of an experiment file is made of: checked fields, durations with a unit, plug-ins; and plain JSON values."""

from __future__ import annotations

import dataclasses
import math
import typing
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, NoReturn, get_args

import msgspec
import numpy as np
from msgspec import Struct

from hil.errors import HilError
from hil.plugins import registry
from plants.parts import Signal
from transport.durations import in_seconds

if TYPE_CHECKING:
    from design.controllers import Controller
    from hil.plugins.user_plugins import Designer
    from plants.parts.protocols import Plant
    from transport.laws import NetworkLaw

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

    ``faults(values)`` checks the fields that could be converted, whether or not the others could; before, ``completed(values)``
    adds what follows from them.
    """

    @staticmethod
    def completed(values: dict[str, Any]) -> dict[str, Any]:
        """Return the fields with those that the others say."""
        return values

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


def named_twice(values: typing.Mapping[str, Any], field: str) -> typing.Iterator[str]:
    """Yield which names of a list stand in it before."""
    names = values.get(field, ())
    yield from (f"{field}[{i}]: {name!r} is named twice" for i, name in enumerate(names) if name in names[:i])


class PlugIn(NamedTuple):
    """Marks a field whose own table a plug-in fills, as its kind says: plant, controller, network law.

    Args:
        group: of the plug-in.
    """

    group: registry.Group


def plug_in_of(hint: Any) -> PlugIn | None:
    """Return the mark of a field's annotation, None where it has none."""
    return next((each for each in get_args(hint) if isinstance(each, PlugIn)), None)


if TYPE_CHECKING:
    PlantTable = Plant
    ControllerTable = Controller | Designer
    LawTable = NetworkLaw
else:  # what msgspec reads at run time
    PlantTable, ControllerTable, LawTable = (
        Annotated[Any, PlugIn(group)] for group in ("hil.plants", "hil.controllers", "hil.laws")
    )


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


class UnavailablePlugin(Struct, frozen=True, kw_only=True):
    """A plant or a controller that ran, and cannot be made again from its log alone.

    Args:
        field: table of the experiment, "plant" or "controller".
        kind: what the log says of it.
        why: what it would need.
        said: the rest of its table, as the log has it.
    """

    field: str
    kind: str
    why: str
    said: dict[str, Any]

    inputs: tuple[Signal, ...] = ()
    outputs: tuple[Signal, ...] = ()
    states: tuple[Signal, ...] = ()

    def model(self) -> NoReturn:
        """Raise `HilError`."""
        raise self.missing()

    def start(self, given: object) -> NoReturn:
        """Raise `HilError`."""
        raise self.missing()

    def missing(self) -> HilError:
        """Return what is to be raised for it."""
        return HilError(f"{self.field}: {self.why}")
