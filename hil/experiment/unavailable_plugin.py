"""What stands in an experiment that a log carries, in the place of what no file made: enough to be measured, not to be run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NoReturn

from hil.errors import HilError
from plants.parts.linear import Signal


@dataclass(frozen=True, slots=True, kw_only=True)
class UnavailablePlugin:
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
