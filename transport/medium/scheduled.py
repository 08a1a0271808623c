"""Media on which nodes wait for each other: by turns, in a fixed cycle or by chance, or by arbitration on a bus."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from math import nan
from typing import Protocol

import numpy as np

from transport.draws import LOST, NO_MODE, REPLACED, SUPERSEDED, Draw, cumulative
from transport.errors import FieldError
from transport.medium import Delivery
from transport.medium.independent import Impairment


class Turns(Protocol):
    """Says whose turn each slot is, and whether what is sent in it gets through."""

    def turn(self) -> tuple[int, bool]:
        """Return the node of the next slot, and whether its packet is lost; called once a slot, from slot 0."""


class RoundRobin:
    r"""The nodes send one after the other: :math:`I(k) = \mathrm{order}[(k + \mathrm{phase}) \bmod L]`.

    Args:
        order: nodes in the order of their turns.
        phase: position in the order in slot 0, from 0.
        loss: probability that what is sent is lost, independent in every slot.
        rng: the stream of this medium; nothing else may draw from it.

    Reference: thesis (5.2).
    """

    def __init__(self, order: Iterable[int], phase: int, loss: float, rng: np.random.Generator) -> None:
        self._order, self._at, self._loss, self._random = tuple(order), phase, loss, rng.random

    def turn(self) -> tuple[int, bool]:
        """See `Turns.turn`."""
        node = self._order[self._at % len(self._order)]
        self._at += 1
        return node, float(self._random()) < self._loss


class RandomTurns:
    """Who sends is a Markov chain over the nodes; with equal rows the turns are independent.

    Args:
        nodes: nodes, in the order of the matrix.
        matrix: Pr(next | last), rows that sum to 1.
        initial: probability of each node in slot 0.
        loss: probability that what is sent is lost, independent in every slot.
        rng: the stream of this medium; nothing else may draw from it.

    Reference: thesis Remark 5.3.
    """

    def __init__(
        self, nodes: Iterable[int], matrix: Sequence[Sequence[float]], initial: Sequence[float], loss: float,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self._nodes, self._initial = tuple(nodes), cumulative(initial)
        self._rows = [cumulative(row) for row in matrix]
        self._last, self._loss, self._random = -1, loss, rng.random

    def turn(self) -> tuple[int, bool]:
        """See `Turns.turn`."""
        row = self._initial if self._last < 0 else self._rows[self._last]
        self._last = bisect_right(row, float(self._random()))
        return self._nodes[self._last], float(self._random()) < self._loss


class ScheduledMedium:
    """Nodes that take turns, with channels of their own; see `transport.medium.Medium`.

    What a node sends in its turn travels through the node's own channel; what it offers out of turn is not sent.

    Args:
        channels: the emulated network of each node.
        turns: whose turn it is.
    """

    def __init__(self, channels: Sequence[Impairment], turns: Turns) -> None:
        self._channels, self._turns = tuple(channels), turns
        self._slot, self._now = -1, (-1, False)  # whose turn it is, and whether what is sent gets lost
        self._lost: list[tuple[int, Draw]] = []

    def _open(self, k: int) -> None:
        while self._slot < k:
            self._slot += 1
            self._now = self._turns.turn()

    def may_send(self, node: int, k: int) -> bool:
        """Return whether it is the node's turn, see `Medium.may_send`."""
        self._open(k)
        return self._now[0] == node

    def offer(self, node: int, k: int, packet: object) -> None:
        """Send a packet, see `Medium.offer`.

        Raises:
            ValueError: it is not the node's turn.
        """
        if not self.may_send(node, k):
            raise FieldError("node", f"{node} sends in slot {k}, which belongs to another node")
        if self._now[1]:
            self._lost.append((node, Draw(k, k, NO_MODE, 0, nan, LOST)))
        else:
            self._channels[node].offer(k, packet)

    def collect(self, k: int) -> list[Delivery]:
        """Return what each channel lets arrive, see `Medium.collect`."""
        self._open(k)
        found = [channel.collect(k) for channel in self._channels]
        for node, draw in self._lost:
            found[node][0].append(draw)
        self._lost = []
        return found


REMEMBERED = 4096
"""Packets of a node whose slot of sampling is kept, for records about them."""


class Behind:
    """The channel behind a bus: it takes one packet a slot, the newest, and names it by the slot of its sample.

    Args:
        channel: the emulated network from the bus on.
    """

    def __init__(self, channel: Impairment) -> None:
        self._channel = channel
        self._slots: dict[int, int] = {}  # slot of sampling by slot of sending
        self._newest = -1
        self._booked: list[Draw] = []

    def book(self, k: int, slots: Sequence[int], reason: int) -> None:
        """Book in slot k that packets of some slots were lost or replaced."""
        self._booked += [Draw(k, slot, NO_MODE, 0 if reason == LOST else k - slot, nan, reason) for slot in slots]

    def carry(self, k: int, came: Sequence[tuple[int, object]]) -> None:
        """Send on the newest of the packets that the bus has carried in slot k, each with the slot of its sample."""
        fresh = [(slot, packet) for slot, packet in came if slot > self._newest]
        newest = max(fresh, key=lambda each: each[0], default=None)
        self.book(k, [g for g, _ in came if newest is None or g != newest[0]], SUPERSEDED)
        if newest is None:
            return
        self._newest = newest[0]
        self._slots[k] = newest[0]
        if len(self._slots) > REMEMBERED:
            del self._slots[next(iter(self._slots))]
        self._channel.offer(k, newest)

    def collect(self, k: int) -> Delivery:
        """Return what the channel lets arrive, and what was booked; see `Impairment.collect`."""
        draws, arrivals = self._channel.collect(k)
        slots, booked = self._slots, self._booked
        self._booked = []
        named = [draw._replace(packet_slot=slots.get(draw.packet_slot, draw.packet_slot)) for draw in draws]
        return [*named, *booked], [packet for _, packet in arrivals]  # type: ignore[misc]


class ArbitratedBus:
    """Nodes that share a bus with arbitration; see `transport.medium.Medium`.

    A bus on which the lowest identifier wins: a frame that loses waits, and a newer sample of its node takes its place.

    In a slot the bus carries a stated number of frames; `transport.medium.timed_bus` has one that counts bits.

    A packet that wins travels through its node's own channel from that slot on. It arrives under the slot in which it was
    offered: the age of its sample counts the wait.

    Args:
        channels: the emulated network of each node behind the bus; a smaller index wins.
        frames: frames that the bus carries in a slot.
        loss: probability that what the bus carries is lost, independent for every frame.
        rng: the stream of this bus; nothing else may draw from it.
    """

    def __init__(self, channels: Sequence[Impairment], frames: int, loss: float, rng: np.random.Generator) -> None:
        if frames < 1:
            raise FieldError("frames", f"{frames} in a slot, expected at least 1")
        self._behind = [Behind(channel) for channel in channels]
        self._frames, self._loss, self._rng = min(frames, len(channels)), loss, rng
        self._waiting: dict[int, tuple[int, object]] = {}  # by node, of which slot each is
        self._next = 0

    def may_send(self, node: int, k: int) -> bool:
        """Return True: a node may offer in every slot, and waits for the bus."""
        return True

    def offer(self, node: int, k: int, packet: object) -> None:
        """Let a packet wait for the bus, see `Medium.offer`.

        Raises:
            ValueError: slot k has been collected, or the node has offered in it already.
        """
        if k < self._next:
            raise FieldError("k", f"slot {k} is offered a packet after it was collected")
        if node in self._waiting:
            old, _ = self._waiting[node]
            if old >= k:
                raise FieldError("k", f"node {node} offers a packet in slot {k} after one in slot {old}")
            self._behind[node].book(k, [old], REPLACED)
        self._waiting[node] = k, packet

    def collect(self, k: int) -> list[Delivery]:
        """Return what the bus has carried and each channel lets arrive, see `Medium.collect`."""
        for slot in range(self._next, k + 1):
            self._carry(slot)
        self._next = k + 1
        return [behind.collect(k) for behind in self._behind]

    def _carry(self, k: int) -> None:
        lost = (self._rng.random(self._frames) < self._loss).tolist()
        for node, gone in zip(sorted(self._waiting), lost):
            won = self._waiting.pop(node)
            if gone:
                self._behind[node].book(k, [won[0]], LOST)
            else:
                self._behind[node].carry(k, [won])
