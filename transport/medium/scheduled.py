"""A medium on which nodes take turns: in every slot one of its nodes may send, by a fixed cycle or by chance.

What a node sends in its turn travels through the node's own channel; what it offers out of turn is not sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from math import nan
from typing import Protocol

import numpy as np

from transport.draws import LOST, NO_MODE, Draw
from transport.errors import FieldError
from transport.medium.independent import Impairment
from transport.medium.medium import Delivery


class Turns(Protocol):
    """Says whose turn each slot is, and whether what is sent in it gets through."""

    def turn(self) -> tuple[int, bool]:
        """Return the node of the next slot, and whether its packet is lost; called once a slot, from slot 0."""
        ...


class RoundRobin:
    r"""The nodes send one after the other: :math:`I(k) = \mathrm{order}[(k + \mathrm{phase}) \bmod L]`.

    Args:
        order: nodes in the order of their turns.
        phase: position in the order in slot 0, from 0.
        loss: probability that what is sent is lost, independent in every slot.
        rng: the stream of this medium; nothing else may draw from it.

    Reference: thesis (5.2).
    """

    def __init__(self, order: Sequence[int], phase: int, loss: float, rng: np.random.Generator) -> None:
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
        self, nodes: Sequence[int], matrix: Sequence[Sequence[float]], initial: Sequence[float], loss: float,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self._nodes, self._initial = tuple(nodes), list(accumulate(initial))
        self._rows = [list(accumulate(row)) for row in matrix]
        self._last, self._loss, self._random = -1, loss, rng.random

    def turn(self) -> tuple[int, bool]:
        """See `Turns.turn`."""
        row = self._initial if self._last < 0 else self._rows[self._last]
        drawn = float(self._random()) * row[-1]
        self._last = next((i for i, total in enumerate(row) if drawn < total), len(row) - 1)
        return self._nodes[self._last], float(self._random()) < self._loss


class ScheduledMedium:
    """Nodes with channels of their own, some of which take turns; see `transport.medium.medium.Medium`.

    Args:
        channels: the emulated network of each node.
        schedules: (nodes that share a medium, whose turn it is) for each shared medium; a node in none sends when it will.
    """

    def __init__(self, channels: Sequence[Impairment], schedules: Sequence[tuple[Sequence[int], Turns]]) -> None:
        self._channels = tuple(channels)
        self._turns = [turns for _, turns in schedules]
        self._shared = {node: i for i, (nodes, _) in enumerate(schedules) for node in nodes}
        self._slot = -1
        self._now: list[tuple[int, bool]] = []
        self._lost: list[tuple[int, Draw]] = []

    def _open(self, k: int) -> None:
        while self._slot < k:
            self._slot += 1
            self._now = [turns.turn() for turns in self._turns]

    def may_send(self, node: int, k: int) -> bool:
        """Return whether it is the node's turn, see `Medium.may_send`."""
        self._open(k)
        shared = self._shared.get(node)
        return shared is None or self._now[shared][0] == node

    def offer(self, node: int, k: int, packet: object) -> None:
        """Send a packet, see `Medium.offer`.

        Raises:
            ValueError: it is not the node's turn.
        """
        if not self.may_send(node, k):
            raise FieldError("node", f"{node} sends in slot {k}, which belongs to another node")
        shared = self._shared.get(node)
        if shared is not None and self._now[shared][1]:
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
