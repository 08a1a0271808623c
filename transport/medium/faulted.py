"""Faults on the time line of a medium: what happens to packets while something is broken."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Final, Literal, NamedTuple

from transport.draws import CORRUPTED, CUT, DELIVERED, DISORDERED, DUPLICATED, NO_MODE, OFF_BUS, REPEATED, Draw
from transport.medium import Delivery, Medium
from transport.medium.independent import Arrivals

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
