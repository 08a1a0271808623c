"""The frames that wait in a node for the bus."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from transport.can_bus_model.bits import CanFrame, FrameLength, arbitration_key, wire_bits

BufferKind = Literal["fifo", "priority", "overwritten"]
"""``fifo``: the oldest frame goes first, whatever its identifier. ``priority``: the one that wins over the others.
``overwritten``: so too, and a newer frame takes the place of one with its identifier that waits."""


@dataclass(slots=True, eq=False)
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
    tag: object = None
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

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def frames(self) -> tuple[Waiting, ...]:
        """What waits, in the order in which it was queued."""
        return tuple(self._waiting)

    def queue(self, new: Waiting) -> Waiting | None:
        """Let a frame wait; return the older one whose place it takes."""
        if self._kind == "overwritten":
            for i, old in enumerate(self._waiting):
                if old.key == new.key:
                    self._waiting[i] = new
                    return old
        self._waiting.append(new)
        return None

    def head(self) -> Waiting:
        """Return the frame that takes part in arbitration; there is one."""
        waiting = self._waiting
        if self._kind == "fifo" or len(waiting) == 1:
            return waiting[0]
        return min(waiting, key=lambda each: each.key)  # of equal ones the oldest

    def remove(self, which: Waiting) -> bool:
        """Take out a frame that was sent or is aborted; return whether it still waited."""
        if which in self._waiting:
            self._waiting.remove(which)
            return True
        return False
