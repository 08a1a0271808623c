"""What nodes share on their way: a medium takes what they offer in a slot and says what arrives at the receiver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from transport.draws import Draw
from transport.medium.independent import Arrivals, Impairment

Delivery = tuple[list[Draw], Arrivals]
"""Of one node in one slot: the decisions that were drawn, and the arrivals as (packet_tick, packet)."""


class Medium(Protocol):
    """The network between some nodes and one receiver; nodes are counted from 0.

    A medium decides about all of its nodes together, so that one node may wait for another: a schedule, or a bus on which
    the smaller identifier wins.
    """

    def may_send(self, node: int, k: int) -> bool:
        """Return whether slot k is the node's to send in, as its own clock tells it; asked before `offer`, slots in order."""
        ...

    def offer(self, node: int, k: int, packet: object) -> None:
        """Take a packet that a node sends in slot k, before `collect(k)`; at most one per node and slot.

        Raises:
            ValueError: slot k has been collected, or the node has sent already.
        """
        ...

    def collect(self, k: int) -> Sequence[Delivery]:
        """Return what became of the packets of every node in slot k, one entry per node.

        Raises:
            ValueError: slot k has been collected before.
        """
        ...


class IndependentChannels:
    """Every node has a channel of its own: no node delays another.

    Args:
        channels: the emulated network of each node.
    """

    def __init__(self, channels: Sequence[Impairment]) -> None:
        self._channels = tuple(channels)

    def may_send(self, node: int, k: int) -> bool:
        """Return True: every slot is everybody's."""
        return True

    def offer(self, node: int, k: int, packet: object) -> None:
        """Send a packet over the node's own channel, see `Medium.offer`."""
        self._channels[node].offer(k, packet)

    def collect(self, k: int) -> list[Delivery]:
        """Return what each channel lets arrive, see `Medium.collect`."""
        channels = self._channels
        return [channels[0].collect(k)] if len(channels) == 1 else [channel.collect(k) for channel in channels]
