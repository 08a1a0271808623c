"""A plant that was changed between two slots, and stands already where the next one begins."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hil.plugins.protocols import PlantRun


class Arrived:
    """A plant whose next advance has happened before its parameters were changed: it is skipped.

    Args:
        after: the plant with its new parameters.
        replace: takes `after` once that advance is asked for.
    """

    def __init__(self, after: PlantRun, replace: Callable[[PlantRun], None]) -> None:
        self.after, self._replace = after, replace
        self.measure = after.measure

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Move nothing."""
        self._replace(self.after)

    @property
    def state(self) -> tuple[float, ...]:
        """Of the plant."""
        return self.after.state

    @property
    def applied(self) -> tuple[float, ...]:
        """Of the plant."""
        return self.after.applied
