"""What other nodes send on the bus: messages that come again and again, or a recording, in the order in which they are queued."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from transport.can_bus_model import CanFrame
from transport.errors import FieldError

AHEAD: Final = 64
"""Frames of a message whose content is drawn at once."""


class Due(NamedTuple):
    """A frame that a node queues.

    Attributes:
        at_ns: when.
        node: number of the node on the bus.
        frame: what it sends.
    """

    at_ns: int
    node: int
    frame: CanFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class Periodic:
    """A message that comes again and again.

    Args:
        node: number of the node that sends it.
        frame: what is sent; with ``random`` of that length.
        period_ns: from one to the next.
        offset_ns: when the first one is due.
        jitter_ns: each is queued later by 0 to this, uniform and independent, and never before the one before it.
        random: every frame has random bytes.

    Raises:
        ValueError: a time that is none; the message begins with its field.
    """

    node: int
    frame: CanFrame
    period_ns: int
    offset_ns: int = 0
    jitter_ns: int = 0
    random: bool = False

    def __post_init__(self) -> None:
        if self.period_ns <= 0:
            raise FieldError("period_ns", f"{self.period_ns}, expected more than 0")
        if self.offset_ns < 0 or self.jitter_ns < 0:
            raise FieldError("offset_ns", f"{self.offset_ns} with jitter {self.jitter_ns}, expected none below 0")

    def frames(self, rng: np.random.Generator) -> Iterator[Due]:
        """Yield every frame, in order.

        Args:
            rng: the stream of this message; nothing else may draw from it.
        """
        due, last, frame = self.offset_ns, 0, self.frame
        drawn = self._contents(rng)
        while True:
            late = int(rng.integers(self.jitter_ns + 1)) if self.jitter_ns else 0
            last = max(last, due + late)
            if self.random:
                frame = CanFrame(
                    identifier=frame.identifier, data=next(drawn), extended=frame.extended, fd=frame.fd,
                    bitrate_switch=frame.bitrate_switch,
                )  # fmt: skip
            yield Due(last, self.node, frame)
            due += self.period_ns

    def _contents(self, rng: np.random.Generator) -> Iterator[bytes]:
        """Yield random bytes as if drawn frame by frame: whole words of 32 bits, many at once where nothing else is drawn."""
        length, ahead = len(self.frame.data), 1 if self.jitter_ns else AHEAD
        words = 4 * (-(-length // 4))
        while True:
            drawn = rng.bytes(words * ahead)
            yield from (drawn[at : at + length] for at in range(0, len(drawn), words))


class Traffic:
    """Everything that other nodes queue, in order of time.

    Args:
        sources: each yields frames in order of time; of one instant the earlier source comes first.
    """

    def __init__(self, sources: Iterable[Iterator[Due]]) -> None:
        self._sources = heapq.merge(*sources, key=lambda due: due.at_ns)
        self._next = next(self._sources, None)

    def until(self, ns: int) -> Iterator[Due]:
        """Yield what is queued up to an instant and at it."""
        while (due := self._next) is not None and due.at_ns <= ns:
            self._next = next(self._sources, None)
            yield due
