"""What takes offered packets and says what arrives where: nodes share a medium on their way, and send as their clocks say.

A medium may be replaced in a run, and have faults on its time line: what happens to packets while something is broken.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import nan
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np

from transport.draws import CORRUPTED, CUT, DELIVERED, DISORDERED, DUPLICATED, NO_MODE, OFF_BUS, REPEATED, Draw
from transport.errors import FieldError
from transport.medium.independent import Arrivals, Impairment

Delivery = tuple[list[Draw], Arrivals]
"""Of one node in one slot: the decisions that were drawn, and the arrivals as (packet_slot, packet)."""


class Medium(Protocol):
    """The network between some nodes and one receiver; nodes are counted from 0.

    A medium decides about all of its nodes together, so that one node may wait for another: a schedule, or a bus on which
    the smaller identifier wins.
    """

    def may_send(self, node: int, k: int) -> bool:
        """Return whether slot k is the node's to send in, by its own clock; asked before `offer`, slots in order."""

    def offer(self, node: int, k: int, packet: object) -> None:
        """Take a packet that a node sends in slot k, before `collect(k)`; at most one per node and slot.

        Raises:
            ValueError: slot k has been collected, or the node has sent already.
        """

    def collect(self, k: int) -> Sequence[Delivery]:
        """Return what became of the packets of every node in slot k, one entry per node.

        Raises:
            ValueError: slot k has been collected before.
        """


class IndependentChannels:
    """Every node has a channel of its own: no node delays another.

    Args:
        channels: the emulated network of each node.
    """

    def __init__(self, channels: Sequence[Impairment]) -> None:
        self._channels = tuple(channels)

    def may_send(self, node: int, k: int) -> bool:
        """Return True: every node may send in every slot."""
        return True

    def offer(self, node: int, k: int, packet: object) -> None:
        """Send a packet over the node's own channel, see `Medium.offer`."""
        self._channels[node].offer(k, packet)

    def collect(self, k: int) -> list[Delivery]:
        """Return what each channel lets arrive, see `Medium.collect`."""
        channels = self._channels
        return [channels[0].collect(k)] if len(channels) == 1 else [channel.collect(k) for channel in channels]


class OneWay:
    """A medium of one node, as one direction: so faults and changes of the way to the actuator are those of a sensor node.

    See `transport.medium.independent.Impairment`.

    Args:
        medium: of one node.
    """

    def __init__(self, medium: Medium) -> None:
        self._medium = medium

    def offer(self, k: int, packet: object) -> None:
        """See `Impairment.offer`."""
        self._medium.offer(0, k, packet)

    def collect(self, k: int) -> Delivery:
        """See `Impairment.collect`."""
        return self._medium.collect(k)[0]


class SplitMedium:
    """Hands every node to its own medium; see `transport.medium.Medium`.

    Args:
        parts: (node numbers, their medium, which counts them from 0 in this order); every node stands in one part.
    """

    def __init__(self, parts: Sequence[tuple[Sequence[int], Medium]]) -> None:
        self._parts = [(tuple(nodes), medium) for nodes, medium in parts]
        self._of = {node: (medium, i) for nodes, medium in self._parts for i, node in enumerate(nodes)}

    def may_send(self, node: int, k: int) -> bool:
        """See `Medium.may_send`."""
        medium, own = self._of[node]
        return medium.may_send(own, k)

    def offer(self, node: int, k: int, packet: object) -> None:
        """See `Medium.offer`."""
        medium, own = self._of[node]
        medium.offer(own, k, packet)

    def collect(self, k: int) -> list[Delivery]:
        """See `Medium.collect`."""
        found: dict[int, Delivery] = {}
        for nodes, medium in self._parts:
            found |= zip(nodes, medium.collect(k))
        return [found[node] for node in sorted(found)]


class ChangingMedium:
    """A medium that may be replaced in a run: the new one takes over what is on its way.

    It begins a few slots before it takes over, as many as the longest delay has: of the packets since then it decides as if they
    had been sent under it; what it would have let arrive before is in use, or lost. What a change costs does not depend on how
    long the run has gone on.

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


class SampleClock:
    r"""Sample i is due in slot :math:`\mathrm{phase} + i\,\mathrm{every} + J_i`, the J independent and uniform on 0, ..., jitter.

    Args:
        every: slots between two samples, without jitter.
        phase: slot of the first, without jitter; None: drawn once, uniform on 0, ..., every - 1.
        jitter: largest J in slots, less than ``every``.
        rng: the stream of this clock; nothing else may draw from it. None where nothing is drawn.

    Raises:
        ValueError: a number that does not fit; the message begins with its name.

    >>> clock = SampleClock(every=3, phase=1)
    >>> [k for k in range(9) if clock.due(k)]
    [1, 4, 7]
    """

    def __init__(self, *, every: int = 1, phase: int | None = 0, jitter: int = 0, rng: np.random.Generator | None = None) -> None:
        if every < 1:
            raise FieldError("every", f"{every} slots, expected at least 1")
        if not 0 <= jitter < every:
            raise FieldError("jitter", f"{jitter} slots, expected 0 to every - 1 = {every - 1}")
        if phase is not None and not 0 <= phase < every:
            raise FieldError("phase", f"{phase}, expected 0 to every - 1 = {every - 1}")
        if rng is None and (jitter or phase is None):
            raise FieldError("rng", "a clock with jitter or a random phase needs a random stream")
        self._every, self._jitter, self._rng = every, jitter, rng
        self._base = int(rng.integers(every)) if phase is None and rng is not None else phase or 0
        self._next = self._base + self._drawn()

    def _drawn(self) -> int:
        return int(self._rng.integers(self._jitter + 1)) if self._rng is not None else 0

    def due(self, k: int) -> bool:
        """Return whether slot k has a sample to send; called in order, in every slot."""
        if k < self._next:
            return False
        self._base += self._every
        self._next = self._base + self._drawn()
        return True


FaultKind = Literal["cut", "corrupt", "freeze", "bus-off"]

REMEMBERED: Final = 4096
"""Lost packets of a node whose slot is kept: an age law may name them again."""

LOSES: Final = {"bus-off": OFF_BUS, "cut": CUT, "corrupt": CORRUPTED}
"""Kinds by which nothing arrives, and the fate of what would have; of two at once, the first."""
_ARRIVED: Final = frozenset((DELIVERED, DISORDERED, DUPLICATED, REPEATED))


class FaultInterval(NamedTuple):
    """A time for which something is broken.

    Attributes:
        first: first slot.
        end: slot in which it is over.
        kind: ``cut`` (nothing arrives), ``corrupt`` (what arrives is refused by the receiver's CRC), ``freeze`` (what is sent has
            the values of the last packet before) or ``bus-off`` (nothing is sent, and nothing arrives).
    """

    first: int
    end: int
    kind: FaultKind


class FaultyPath:
    """The way of one node's packets, with faults on it.

    Args:
        intervals: when what is broken; they may overlap.
    """

    def __init__(self, intervals: Sequence[FaultInterval]) -> None:
        self._intervals = tuple(intervals)
        self._last: object = None
        self._lost: dict[int, int] = {}  # slot of sending to fate
        self._unsent: list[Draw] = []
        self.mangled: Arrivals = []

    def plan(self, intervals: Sequence[FaultInterval]) -> None:
        """Replace the time line; what was lost stays lost."""
        self._intervals = tuple(intervals)

    def _broken(self, k: int) -> set[FaultKind]:
        return {kind for first, end, kind in self._intervals if first <= k < end}

    def sent(self, k: int, packet: object) -> object | None:
        """Return what leaves when a packet is offered in slot k, None if nothing does.

        Args:
            k: slot.
            packet: what the node sends.
        """
        broken = self._broken(k)
        if "freeze" not in broken or self._last is None:
            self._last = packet
        if "bus-off" in broken:
            self._unsent.append(Draw(k, k, NO_MODE, 0, nan, OFF_BUS))
            return None
        return self._last

    def came(self, k: int, delivery: Delivery) -> Delivery:
        """Return what the receiver gets of what would arrive in slot k, with the fate of the rest.

        A packet that was lost stays lost, though an age law takes it for the newest in later slots too. What arrives with a
        flipped bit stands in `mangled`.
        """
        draws, arrivals = delivery
        broken, lost = self._broken(k), self._lost
        fate = next((code for kind, code in LOSES.items() if kind in broken), None)
        gone: dict[int, int] = {}
        for reason, g in [(draw.reason, draw.packet_slot) for draw in draws if draw.reason in _ARRIVED]:
            if fate is not None:
                gone[g] = fate
                if reason != REPEATED:
                    lost[g] = fate
                    if len(lost) > REMEMBERED:
                        del lost[next(iter(lost))]
            elif g in lost and reason == REPEATED:
                gone[g] = lost[g]
            else:
                lost.pop(g, None)  # a second copy has come
        self.mangled = arrivals if fate == CORRUPTED else []
        if gone:
            draws = [d._replace(reason=gone.get(d.packet_slot, d.reason)) if d.reason in _ARRIVED else d for d in draws]
            arrivals = [(g, packet) for g, packet in arrivals if g not in gone]
        if self._unsent:
            draws, self._unsent = [*draws, *self._unsent], []
        return draws, arrivals


class FaultedMedium:
    """A medium with faults on its time line; see `transport.medium.Medium`.

    The medium behind it draws what it would draw without them: modes and latencies stay those of the run without faults.

    Args:
        medium: what carries the packets.
        paths: the faults of each node.
    """

    def __init__(self, medium: Medium, paths: Sequence[FaultyPath]) -> None:
        self._medium, self._paths = medium, tuple(paths)

    def may_send(self, node: int, k: int) -> bool:
        """See `Medium.may_send`."""
        return self._medium.may_send(node, k)

    def offer(self, node: int, k: int, packet: object) -> None:
        """See `Medium.offer`."""
        sent = self._paths[node].sent(k, packet)
        if sent is not None:
            self._medium.offer(node, k, sent)

    def collect(self, k: int) -> list[Delivery]:
        """See `Medium.collect`."""
        return [path.came(k, delivery) for path, delivery in zip(self._paths, self._medium.collect(k), strict=True)]
