"""A network whose law is changed in a run: the new law takes over what is on its way.

The new medium begins a few slots before it takes over, as many as the longest delay has: of the packets since then it decides as
if they had been sent under it; what it would have let arrive before is in use, or lost. What a change costs does not depend on
how long the run has gone on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from transport.medium.independent import Impairment
from transport.medium.medium import Delivery, Medium


class ChangingMedium:
    """A medium that may be replaced in a run; see `transport.medium.medium.Medium`.

    Args:
        medium: the first.
        nodes: number of nodes.
        depth: slots whose packets are kept for the next medium: the longest age, at least.
    """

    def __init__(self, medium: Medium, nodes: int, depth: int) -> None:
        self._medium = medium
        self._past: tuple[deque[tuple[int, object]], ...] = tuple(deque(maxlen=depth) for _ in range(nodes))

    def may_send(self, node: int, k: int) -> bool:
        """See `Medium.may_send`."""
        return self._medium.may_send(node, k)

    def offer(self, node: int, k: int, packet: object) -> None:
        """See `Medium.offer`."""
        self._past[node].append((k, packet))
        self._medium.offer(node, k, packet)

    def collect(self, k: int) -> Sequence[Delivery]:
        """See `Medium.collect`."""
        return self._medium.collect(k)

    def change(self, medium: Medium, k: int, first: int) -> None:
        """Let another medium, whose laws begin in slot `first`, take over before anything is offered in slot k."""
        for node, past in enumerate(self._past):
            for g, packet in past:
                if g >= first:
                    medium.offer(node, g, packet)
        if k > first:
            medium.collect(k - 1)
        self._medium = medium


class ChangingChannel:
    """One direction whose network may be replaced in a run; see `transport.medium.independent.Impairment`.

    Args:
        channel: the first.
        depth: slots whose packets are kept for the next one: the longest age, at least.
    """

    def __init__(self, channel: Impairment, depth: int) -> None:
        self._channel, self._past = channel, deque[tuple[int, object]](maxlen=depth)

    @property
    def pending(self) -> int:
        """Number of offered packets that may still arrive for the first time."""
        return self._channel.pending

    def offer(self, k: int, packet: object) -> None:
        """See `Impairment.offer`."""
        self._past.append((k, packet))
        self._channel.offer(k, packet)

    def collect(self, k: int) -> Delivery:
        """See `Impairment.collect`."""
        return self._channel.collect(k)

    def change(self, channel: Impairment, k: int, first: int) -> None:
        """Let another network, whose law begins in slot `first`, take over before anything is offered in slot k."""
        for g, packet in self._past:
            if g >= first:
                channel.offer(g, packet)
        if k > first:
            channel.collect(k - 1)
        self._channel = channel
