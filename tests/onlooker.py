"""Who looks at a session's records, and neither paces nor changes it; see `hil.session.Onlooker`."""

from __future__ import annotations

from collections.abc import Mapping

from hil.log.records import Channel
from hil.log.write import PayloadWriter
from hil.rig.loop import Loop


class Looks:
    """Takes the records of some topics.

    Args:
        takers: topic to what gets time and payload.
    """

    clock = changes = None

    def __init__(self, takers: Mapping[str, PayloadWriter]) -> None:
        self._takers = takers

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Return the takers."""
        return self._takers

    def end(self) -> None:
        """It waits for nothing."""
