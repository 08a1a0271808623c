"""The emulated network of one direction: packets are offered in the slot of sending, collected in that of arrival."""

from __future__ import annotations

import heapq
from collections import deque
from itertools import count
from math import nan
from typing import Final, Protocol, cast

import numpy as np

from transport.draws import (
    ABSENT,
    COPIED,
    DELIVERED,
    DISORDERED,
    DUPLICATED,
    NO_MODE,
    NONE_YET,
    OVERFLOW,
    REPEATED,
    SENT,
    SUPERSEDED,
    Draw,
)
from transport.errors import FieldError
from transport.laws import AgeLaw, AgeProcess, GapLaw, NetworkLaw, PacketProcess, PerPacketLaw

Arrivals = list[tuple[int, object]]
_new: Final = tuple.__new__  # without the Python constructor: in five files 6 % of an interpreted virtual slot


class Impairment(Protocol):
    """One direction of an emulated network."""

    def offer(self, k: int, packet: object) -> None:
        """Send a packet in slot k, before `collect(k)`; at most one per slot. One that came too late is not offered.

        Raises:
            ValueError: slot k has been collected, or has a packet already: a fault of the caller.
        """

    def collect(self, k: int) -> tuple[list[Draw], Arrivals]:
        """Return the decisions of slot k, and its arrivals as (packet_slot, packet) in order of arrival.

        Slots that were skipped are drawn too, so that the mode sequence depends on nothing but the law and its stream.

        Raises:
            ValueError: slot k has been collected before.
        """


class AgeImpairment:
    """Apply an age law: exactly one packet in every slot, the one of slot k - age.

    Where that packet was never offered, the next older one stands in for it, and an "absent" row says so. A packet is forgotten
    as soon as no later slot can ask for it. Under a law without gaps ages grow by at most one, so that k - age never falls: that
    is every packet older than the one in use. Under one with gaps, which may come back, it is one older than `max_age`.

    Args:
        process: draws the ages.
        period_s: length T of a slot, seconds.
        max_age: of a law with gaps; None for one without.
        first: slot in which the law begins.
    """

    def __init__(self, process: AgeProcess, *, period_s: float, max_age: int | None = None, first: int = 0) -> None:
        self._draw = process.draw
        self._period_s = period_s
        self._max_age = max_age
        self._held: list[tuple[int, object]] = []  # what the receiver may still use
        self._used: set[int] = set()  # slots of those that it has used
        self._newest = -1
        self._next = first

    def offer(self, k: int, packet: object) -> None:
        """Send a packet in slot k, see `Impairment.offer`."""
        held = self._held
        if k < self._next or (held and k <= held[-1][0]):  # here and in `collect` without a call: 6 % of an interpreted slot
            _check_offer(k, self._next, held[-1][0] if held else -1)
        held.append((k, packet))

    def collect(self, k: int) -> tuple[list[Draw], Arrivals]:
        """Return the decisions of slot k and its one arrival (none before the first), see `Impairment.collect`."""
        draws: list[Draw] = []
        if k != self._next:
            _check_collect(k, self._next)
            for slot in range(self._next, k):
                draws += self.collect(slot)[0]
        self._next = k + 1
        mode, age = self._draw()
        target = k - age
        if target < 0:
            draws.append(Draw(k, -1, mode, age, nan, NONE_YET))
            return draws, []
        held, used = self._held, self._used
        oldest = target if self._max_age is None else k - self._max_age
        while len(held) > 1 and held[1][0] <= oldest:
            slot = held.pop(0)[0]
            if slot in used:
                used.remove(slot)
            else:
                draws.append(Draw(k, slot, NO_MODE, k - slot, nan, SUPERSEDED))
        found: tuple[int, object] | None = None
        for each in held:
            if each[0] > target:
                break
            found = each
        if found is None or found[0] != target:
            draws.append(Draw(k, target, mode, age, nan, ABSENT))
            if found is None:
                return draws, []
            mode, age = NO_MODE, k - found[0]
        slot, reason = found[0], REPEATED
        if slot not in used:
            used.add(slot)
            reason = DISORDERED
            if slot > self._newest:
                self._newest, reason = slot, DELIVERED
        draws.append(_new(Draw, (k, slot, mode, age, age * self._period_s, reason)))
        return draws, [found]


class _Offered:
    """A packet that was offered. Its copy shares it: whichever arrives second is the duplicate."""

    __slots__ = ("arrived", "packet", "slot")

    def __init__(self, slot: int, packet: object) -> None:
        self.slot, self.packet, self.arrived = slot, packet, False


class PacketImpairment:
    """Apply a packet law: every packet arrives in the slot that its own latency leads to.

    A packet sent in slot k with latency L arrives in slot k + j, j the smallest j >= 0 with L <= deadline + j T: nodes
    are driven by the clock (section 7.2). Within a slot the arrivals come in order of time. Without reordering a
    packet waits for those sent before it.
    """

    def __init__(self, process: PacketProcess, *, period_s: float, reordering: bool, queue: int, first: int = 0) -> None:
        self._process = process
        self._period_s = period_s
        self._reordering = reordering
        self._queue = queue
        self._offered: deque[_Offered] = deque()
        self._flying: list[tuple[int, float, int, float, _Offered]] = []  # slot, arrival s, order, latency s
        self._order = count()
        self._last = (0, 0.0)
        self._newest = -1
        self._next = first

    def offer(self, k: int, packet: object) -> None:
        """Send a packet in slot k, see `Impairment.offer`."""
        _check_offer(k, self._next, self._offered[-1].slot if self._offered else -1)
        self._offered.append(_Offered(k, packet))

    def collect(self, k: int) -> tuple[list[Draw], Arrivals]:
        """Return the decisions of slot k and its arrivals, see `Impairment.collect`."""
        _check_collect(k, self._next)
        draws: list[Draw] = []
        arrivals: Arrivals = []
        for slot in range(self._next, k + 1):
            self._send(slot, draws)
            while self._flying and self._flying[0][0] <= slot:
                arrivals.append(self._arrive(slot, draws))
        self._next = k + 1
        return draws, arrivals

    def _send(self, k: int, draws: list[Draw]) -> None:
        offered = self._offered.popleft() if self._offered and self._offered[0].slot == k else None
        for draw in self._process.draw(k):
            if offered is None:
                if draw.mode != NO_MODE:
                    draws.append(draw._replace(age=-1, latency_s=nan, reason=ABSENT))
                continue
            if draw.reason in (SENT, COPIED):
                if len(self._flying) >= self._queue:
                    draws.append(draw._replace(age=-1, latency_s=nan, reason=OVERFLOW))
                    continue
                self._fly(draw, offered)
            draws.append(draw)

    def _fly(self, draw: Draw, offered: _Offered) -> None:
        sent_s = draw.slot * self._period_s
        due = (draw.slot + draw.age, sent_s + draw.latency_s)
        if not self._reordering:
            due = self._last = max(due, self._last)
        heapq.heappush(self._flying, (*due, next(self._order), due[1] - sent_s, offered))

    def _arrive(self, k: int, draws: list[Draw]) -> tuple[int, object]:
        *_, latency_s, offered = heapq.heappop(self._flying)
        if offered.arrived:
            reason = DUPLICATED
        else:
            reason = DELIVERED if offered.slot > self._newest else DISORDERED
            offered.arrived = True
        self._newest = max(self._newest, offered.slot)
        draws.append(Draw(k, offered.slot, NO_MODE, k - offered.slot, latency_s, reason))
        return offered.slot, offered.packet


def impair(law: NetworkLaw, rng: np.random.Generator, period_s: float, deadline_s: float, first: int = 0) -> Impairment:
    """Return the emulated network of one direction under a law.

    Args:
        law: parameters of an age law or a packet law.
        rng: the stream of this direction; nothing else may draw from it.
        period_s: length T of a slot, seconds.
        deadline_s: seconds after the start of a slot at which it closes; packet laws only.
        first: slot in which the law begins.

    Raises:
        ValueError: `law.family` is neither "age" nor "packet".
    """
    if law.family == "age":
        age_law = cast(AgeLaw, law)
        # A foreign law that does not say is taken to have gaps: that is safe, it only holds packets for longer.
        gaps = not isinstance(law, GapLaw) or law.allow_gaps
        return AgeImpairment(age_law.start(rng), period_s=period_s, max_age=age_law.max_age if gaps else None, first=first)
    if law.family == "packet":
        packet_law = cast(PerPacketLaw, law)
        process = packet_law.start(rng, period_s, deadline_s)
        return PacketImpairment(process, period_s=period_s, reordering=packet_law.reordering, queue=packet_law.queue, first=first)
    raise FieldError("family", f'got {law.family!r} from law {type(law).__name__}, expected "age" or "packet"')


def _check_offer(k: int, collected: int, last: int) -> None:
    if k < collected:
        raise FieldError("k", f"slot {k} is offered a packet after it was collected")
    if k <= last:
        raise FieldError("k", f"slot {k} is offered a packet after slot {last}, expected one packet per slot in order")


def _check_collect(k: int, expected: int) -> None:
    if k < expected:
        raise FieldError("k", f"slot {k} is collected again, expected {expected} or later")
