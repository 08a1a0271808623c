"""How a node keeps away from a bus that it disturbs: its two error counters, and the states that they lead to.

Reference: ISO 11898-1:2015, 12.1.4.

What happens where two nodes send frames with one identifier: they win together, and differ in a later bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

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


class Collision(NamedTuple):
    """How it ends.

    Attributes:
        senders: who still sends, by position.
        fallen: who saw a dominant bit instead of its own and could not stop the others: its error flag is recessive.
        bit: position at which an error-active node destroys the frame; None if it gets through.
    """

    senders: tuple[int, ...]
    fallen: tuple[int, ...]
    bit: int | None


def collide(wires: Sequence[str], passive: Sequence[bool]) -> Collision:
    """Return what becomes of frames that were begun at once and have not lost arbitration to each other.

    Args:
        wires: bits of each.
        passive: whether its sender is error passive.

    >>> collide(["0010", "0001"], [False, False])
    Collision(senders=(0, 1), fallen=(), bit=2)
    >>> collide(["0010", "0001"], [True, False])
    Collision(senders=(1,), fallen=(0,), bit=None)
    """
    senders = list(range(len(wires)))
    fallen: list[int] = []
    while len(senders) > 1:
        bits = zip(*(wires[i] for i in senders))
        at = next((place for place, column in enumerate(bits) if len(set(column)) > 1), None)
        if at is None:
            break  # the very same frame
        recessive = [i for i in senders if wires[i][at] == "1"]
        if not all(passive[i] for i in recessive):
            return Collision(tuple(senders), tuple(fallen), at)
        fallen += recessive
        senders = [i for i in senders if i not in recessive]
    return Collision(tuple(senders), tuple(fallen), None)
