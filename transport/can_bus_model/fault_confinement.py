"""How a node keeps away from a bus that it disturbs: its two error counters, and the states that they lead to.

Reference: ISO 11898-1:2015, 12.1.4.
"""

from __future__ import annotations

from typing import Final, Literal

State = Literal["active", "warning", "passive", "off"]

WARNING: Final = 96
PASSIVE: Final = 128
BUS_OFF: Final = 256
RECOVERY_SEQUENCES: Final = 128
RECESSIVE_BITS: Final = 11
"""A node that is off the bus comes back after so many times so many recessive bits in a row."""

SUSPENDED_BITS: Final = 8
"""An error-passive node that has sent waits for so many bits more than the others."""


class ErrorCounters:
    """Transmit and receive error counter of one node.

    Attributes:
        tec: transmit error counter.
        rec: receive error counter.
        sequences: times that it has seen 11 recessive bits in a row since it left the bus.
    """

    def __init__(self) -> None:
        self.tec = self.rec = self.sequences = 0

    @property
    def state(self) -> State:
        """Error state; ``warning`` is error active with a counter of 96 or more."""
        if self.tec >= BUS_OFF:
            return "off"
        most = max(self.tec, self.rec)
        return "passive" if most >= PASSIVE else "warning" if most >= WARNING else "active"

    @property
    def passive(self) -> bool:
        """Whether its error flags are recessive."""
        return self.tec >= PASSIVE or self.rec >= PASSIVE

    @property
    def off(self) -> bool:
        """Whether it has left the bus."""
        return self.tec >= BUS_OFF

    def sent(self) -> None:
        """Count a frame that was sent."""
        self.tec -= self.tec > 0

    def received(self) -> None:
        """Count a frame that was received."""
        self.rec = PASSIVE - 1 if self.rec >= PASSIVE else self.rec - (self.rec > 0)

    def send_failed(self, *, unanswered: bool = False) -> None:
        """Count a frame that could not be sent.

        Args:
            unanswered: no node acknowledged it, and none sent a dominant bit during the flag: a passive node counts nothing then.
        """
        if not (unanswered and self.passive):
            self.tec += 8

    def receive_failed(self) -> None:
        """Count a frame that was destroyed while it was received."""
        self.rec = min(self.rec + 1, 255)

    def recover(self) -> None:
        """Come back to the bus, error active."""
        self.tec = self.rec = self.sequences = 0
