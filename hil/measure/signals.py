"""The signals that numbers and pictures are about: outputs, those that follow the reference, inputs, with their units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol, runtime_checkable

from msgspec import Struct
from msgspec.structs import replace

PURE = ("", "1")
"""Units of a pure number."""


class Named(Protocol):
    """One signal of a plant: its name and its unit."""

    @property
    def name(self) -> str: ...

    @property
    def unit(self) -> str: ...


class PlantSignals(Protocol):
    """What a plant says of its signals."""

    @property
    def inputs(self) -> tuple[Named, ...]: ...

    @property
    def outputs(self) -> tuple[Named, ...]: ...


@runtime_checkable
class NamesTracked(Protocol):
    """A plant of which some outputs only follow the reference: it names them (a measured mode follows nothing)."""

    @property
    def tracked(self) -> tuple[str, ...]: ...


class Signals(Struct, frozen=True, kw_only=True):
    """Names and units of a loop's signals.

    Args:
        outputs, inputs: name to unit, in order; no unit for a pure number.
        tracked: the outputs that shall follow the reference, in order.
    """

    outputs: Mapping[str, str]
    inputs: Mapping[str, str]
    tracked: tuple[str, ...]

    def tracked_unit(self) -> str | None:
        """Return the unit that all tracked outputs share, None if they differ."""
        return common(self.outputs[name] for name in self.tracked)

    def input_unit(self) -> str | None:
        """Return the unit that all inputs share, None if they differ."""
        return common(self.inputs.values())

    def only(self, name: str) -> Signals:
        """Return the same signals with one tracked output."""
        return replace(self, tracked=(name,))

    def in_unit(self, unit: str) -> Signals:
        """Return the same signals with one word as the unit of every output, for a table whose columns name the units."""
        return replace(self, outputs=dict.fromkeys(self.outputs, unit))


def signals_of(plant: PlantSignals) -> Signals:
    """Return the signals of a plant; all outputs are tracked unless it names those that are (`NamesTracked`)."""
    outputs = {s.name: bare(s.unit) for s in plant.outputs}
    tracked = tracked_among(plant, outputs)
    return Signals(outputs=outputs, inputs={s.name: bare(s.unit) for s in plant.inputs}, tracked=tracked)


def tracked_among(plant: object, outputs: Iterable[str]) -> tuple[str, ...]:
    """Return those of some outputs that shall follow the reference."""
    return tuple(name for name in outputs if not isinstance(plant, NamesTracked) or name in plant.tracked)


def bare(unit: str) -> str:
    """Return a unit, nothing for a pure number."""
    return "" if unit in PURE else unit


def common(units: Iterable[str]) -> str | None:
    """Return the unit that all share, None if they differ or there are none.

    >>> common(["rad", "rad"]), common(["kn", "deg"])
    ('rad', None)
    """
    found = set(map(bare, units))
    return found.pop() if len(found) == 1 else None


def with_unit(text: str, unit: str) -> str:
    """Return a label with its unit in brackets.

    >>> with_unit("angle", "rad"), with_unit("mode", "1")
    ('angle (rad)', 'mode')
    """
    return text if unit in PURE else f"{text} ({unit})"
