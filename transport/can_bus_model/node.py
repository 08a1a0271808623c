"""A node on a CAN bus: the frames that wait in it, its error counters and its state, and what a collision does to it.

Reference: ISO 11898-1:2015, 12.1.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

from transport.can_bus_model import BitRates, CanFrame, FrameLength, arbitration_key
from transport.can_bus_model.bits import wire_bits

BufferKind = Literal["fifo", "priority", "overwritten"]
"""``fifo``: the oldest frame goes first, whatever its identifier. ``priority``: the one that wins over the others.
``overwritten``: so too, and a newer frame takes the place of one with its identifier that waits."""


@dataclass(eq=False)
class Waiting:
    """A frame that waits, or is being sent.

    Args:
        frame: what is sent.
        queued: since when, in units.
        tag: whatever the sender wants to know it by.
        length: bits that it takes, where its content is not to say so.
    """

    frame: CanFrame
    queued: int
    tag: Any = None
    length: FrameLength | None = None
    key: int = field(init=False)
    lost: int = 0
    attempts: int = 0

    def __post_init__(self) -> None:
        self.key = arbitration_key(self.frame)

    def bits(self) -> FrameLength:
        """Return its length with intermission."""
        return wire_bits(self.frame).length if self.length is None else self.length


class TransmitBuffer:
    """Frames of one node, in the order in which it queued them.

    Args:
        kind: which one takes part in arbitration.
    """

    def __init__(self, kind: BufferKind = "priority") -> None:
        self._kind = kind
        self._waiting: list[Waiting] = []
        self._head: Waiting | None = None  # known until another one may be

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def frames(self) -> tuple[Waiting, ...]:
        """What waits, in the order in which it was queued."""
        return tuple(self._waiting)

    def queue(self, new: Waiting) -> Waiting | None:
        """Let a frame wait; return the older one whose place it takes."""
        self._head = None
        if self._kind == "overwritten":
            for i, old in enumerate(self._waiting):
                if old.key == new.key:
                    self._waiting[i] = new
                    return old
        self._waiting.append(new)
        return None

    def head(self) -> Waiting:
        """Return the frame that takes part in arbitration; there is one."""
        if self._head is None:
            waiting = self._waiting
            first = self._kind == "fifo" or len(waiting) == 1
            self._head = waiting[0] if first else min(waiting, key=lambda each: each.key)  # of equal ones the oldest
        return self._head

    def remove(self, which: Waiting) -> bool:
        """Take out a frame that was sent or is aborted; return whether it still waited."""
        if which in self._waiting:
            self._head = None
            self._waiting.remove(which)
            return True
        return False


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

    They lead a node to the states in which it keeps away from a bus that it disturbs.

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


@dataclass
class CanNode:
    """One node on the bus.

    Args:
        buffer: how its frames wait.
        recovers: whether it comes back by itself from bus-off.
        rates: bit rates that are not the bus's: it receives no frame, and destroys every one while it is error active.
    """

    buffer: BufferKind = "priority"
    recovers: bool = True
    rates: BitRates | None = None
    waiting: TransmitBuffer = field(init=False)
    errors: ErrorCounters = field(default_factory=ErrorCounters)

    def __post_init__(self) -> None:
        self.waiting = TransmitBuffer(self.buffer)


class Collision(NamedTuple):
    """How it ends where two nodes send frames with one identifier: they win together, and differ in a later bit.

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
