"""When a sensor node sends: the event triggers of section 8.2.2, and the turn of a schedule that they do without.

A node that is silent is no loss: the controller holds what it last received.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.experiment.nodes import TriggerTable
from hil.runtime.nodes.sensor_node import Trigger


class Magnitude:
    """The node sends while some |y| is above the threshold: at rest it is silent.

    Args:
        threshold: in the outputs' unit.

    Reference: thesis Section 8.2.2, [217].
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """See `Trigger.sends`."""
        return any(abs(v) > self._threshold for v in y)


class Error:
    """The node sends when some y differs from its measurement of the slot before by more than the threshold.

    Args:
        threshold: in the outputs' unit.

    Reference: thesis Section 8.2.2, [218], Figure 8.2: the error between adjacent measurements.
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold
        self._before: tuple[float, ...] = ()

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """See `Trigger.sends`."""
        before, self._before = self._before, tuple(y)
        return not before or any(abs(a - b) > self._threshold for a, b in zip(y, before))


class DeadBand:
    """The node sends when some y has left the band around what it last offered to send.

    Args:
        threshold: half the width of the band, in the outputs' unit.

    Reference: thesis Section 8.2.2, [219].
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold
        self._sent: tuple[float, ...] = ()

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """See `Trigger.sends`."""
        if self._sent and all(abs(a - b) <= self._threshold for a, b in zip(y, self._sent)):
            return False
        self._sent = tuple(y)
        return True


class Relative:
    """The node sends when some y differs from what it last offered to send by more than a share of |y|.

    Args:
        share: below 1.

    Reference: P. Tabuada, Event-triggered real-time scheduling of stabilizing control tasks, IEEE TAC 52(9), 2007; thesis
    Section 8.2.2.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._sent: tuple[float, ...] = ()

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """See `Trigger.sends`."""
        if self._sent and all(abs(a - b) <= self._share * abs(a) for a, b in zip(y, self._sent)):
            return False
        self._sent = tuple(y)
        return True


def trigger_of(table: TriggerTable) -> Trigger | None:
    """Return the trigger that an experiment asks for; None: the node sends in every slot."""
    threshold = table.threshold
    made: dict[str, Trigger] = {
        "magnitude": Magnitude(threshold), "error": Error(threshold), "dead-band": DeadBand(threshold),
        "relative": Relative(threshold),
    }  # fmt: skip
    return made.get(table.kind)
