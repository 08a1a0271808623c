"""Damping of a device that changes over its workspace: constant from one place to the next, looked up every millisecond.

Reference: Chapter 6, 6.6: the damping b may change in the workspace.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from plants.errors import FieldError, require_finite, require_not_negative
from plants.parts.hand import NEVER_NS

LOOK_NS: Final = 1_000_000
"""How long the damping is that of the place where the tip was."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DampingZone:
    """The damping from a place on.

    Args:
        from_m: place of the tip in m.
        damping: b of the joint there, as `Omni.damping`, at least 0.

    Raises:
        FieldError: where a value is out of range.
    """

    from_m: float
    damping: float

    def __post_init__(self) -> None:
        require_finite("from_m", self.from_m)
        require_not_negative("damping", self.damping)


def check_zones(zones: Sequence[DampingZone]) -> None:
    """Check that they rise.

    Raises:
        FieldError: two of them begin in one place, or are in another order.
    """
    for i, (before, after) in enumerate(pairwise(zones), start=1):
        if not after.from_m > before.from_m:
            raise FieldError(f"zones[{i}].from_m", f"{after.from_m!r}, expected more than {before.from_m!r}, of the one before")


class ZoneRun:
    """When the zone is looked up again; on whole milliseconds, so that cutting an advance in two changes nothing.

    Args:
        zones: in rising order; none: it is never looked up.
    """

    __slots__ = ("_from_m", "looks", "next_ns")

    def __init__(self, zones: Sequence[DampingZone]) -> None:
        self._from_m = [zone.from_m for zone in zones]
        self.looks = False
        self.next_ns = LOOK_NS if zones else NEVER_NS

    @property
    def sources(self) -> tuple[ZoneRun, ...]:
        """Itself, as a source of events; nothing without zones."""
        return (self,) if self._from_m else ()

    def at(self, place_m: float) -> int:
        """Return which zone a place is in: 0 before the first.

        Args:
            place_m: of the tip.
        """
        return bisect_right(self._from_m, place_m)

    def fire(self) -> None:
        """Have it looked up before the next movement."""
        self.looks = True
        self.next_ns += LOOK_NS
