"""Worst-case response times of the messages on a CAN bus, and the load that they make.

Jitter, blocking, deadlines beyond the period and errors count. Everything is a whole number of units of
`transport.can_bus_model`; nothing is rounded.

Reference: Davis, Burns, Bril, Lukkien, Controller Area Network (CAN) schedulability analysis: refuted, revisited and revised,
Real-Time Systems 35 (2007), sections 3 and 4; errors: section 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Final

from msgspec import Struct

from transport.can_bus_model import BitRates, CanFrame, FrameLength, arbitration_key
from transport.can_bus_model.bits import INTERMISSION, frame_bounds
from transport.errors import FieldError


class PeriodicMessage(Struct, frozen=True, kw_only=True):
    """A message that a node sends again and again, and queues by priority.

    Args:
        name: for tables.
        identifier: 11 bits, or 29 where ``extended``.
        length: bytes of data.
        period_ns: least time between two instants at which it is due.
        jitter_ns: it is queued by up to so much later than it is due.
        deadline_ns: from the instant at which it is due; by default the period. It may be longer than the period.
        extended: identifier of 29 bits.
        fd: CAN FD.
        bitrate_switch: with the data bit rate.
        bits: its length with intermission; by default that of the longest frame of so many bytes.
        offset_ns: when the first instance is due, where instants are known.
        shortest: its shortest frame, so; by default one of its length without stuff bits.

    Raises:
        ValueError: a value that no message has; the message begins with its field.
    """

    name: str
    identifier: int
    period_ns: int
    length: int = 8
    jitter_ns: int = 0
    deadline_ns: int | None = None
    extended: bool = False
    fd: bool = False
    bitrate_switch: bool = False
    bits: FrameLength | None = None
    offset_ns: int = 0
    shortest: FrameLength | None = None

    def __post_init__(self) -> None:
        self.key()
        self.frame_length()
        if self.period_ns <= 0:
            raise FieldError("period_ns", f"{self.period_ns}, expected more than 0")
        if self.jitter_ns < 0:
            raise FieldError("jitter_ns", f"{self.jitter_ns} is negative")
        if self.offset_ns < 0:
            raise FieldError("offset_ns", f"{self.offset_ns} is negative")

    def key(self) -> int:
        """Return its place in arbitration: the smaller one wins."""
        return arbitration_key(CanFrame(identifier=self.identifier, extended=self.extended))

    def _bounds(self) -> tuple[FrameLength, FrameLength]:
        return frame_bounds(self.length, extended=self.extended, fd=self.fd, bitrate_switch=self.bitrate_switch)

    def frame_length(self) -> FrameLength:
        """Return the length of its longest frame, with intermission."""
        return self.bits or self._bounds()[1]

    def least_length(self) -> FrameLength:
        """Return the length of its shortest frame, with intermission."""
        return self.shortest or self._bounds()[0]

    @property
    def due_in_ns(self) -> int:
        """Its deadline, ns."""
        return self.period_ns if self.deadline_ns is None else self.deadline_ns


def bus_load(messages: Sequence[PeriodicMessage], rates: BitRates) -> Fraction:
    r"""Return the share of time that the messages need: :math:`\sum C_m / T_m`."""
    shares = (Fraction(rates.duration(each.frame_length()), rates.units(each.period_ns)) for each in messages)
    return sum(shares, start=Fraction(0))


ERROR_BITS: Final = 31
"""An error costs at most so many bits besides the frame that is sent again."""

MOST_TERMS: Final = 10_000_000
"""Terms of sums, some seconds: nearly full buses of a thousand messages would take hours."""


class ErrorBursts(Struct, frozen=True, kw_only=True):
    """At most ``burst`` errors at once, and one more in every ``interval_ns``.

    Args:
        burst: errors that may come at any instant, 1 or more: also a single error comes at any instant.
        interval_ns: between two further ones.

    Raises:
        ValueError: no error, or no interval.
    """

    burst: int = 1
    interval_ns: int

    def __post_init__(self) -> None:
        if self.burst < 1:
            raise FieldError("burst", f"{self.burst}, expected 1 or more")
        if self.interval_ns <= 0:
            raise FieldError("interval_ns", f"{self.interval_ns}, expected more than 0")

    def most(self, units: int, rates: BitRates) -> int:
        """Return how many errors there may be in a time of so many units."""
        return self.burst + max(-(-units // rates.units(self.interval_ns)) - 1, 0)


class ResponseTime(Struct, frozen=True, kw_only=True):
    """The bound of one message.

    Args:
        message: whose it is.
        frame_ns: its longest frame, with intermission.
        blocking_ns: the longest frame of a lower priority that may be on the bus already.
        response_ns: from the instant at which it is due to the end of its frame's EOF; None if it has no bound, or one that takes
            too long to compute.
        intermission_ns: the same to the end of the intermission, as the literature counts; None without a bound.
        delayed_by: names of the messages that win over it.
    """

    message: PeriodicMessage
    frame_ns: int
    blocking_ns: int
    response_ns: int | None
    intermission_ns: int | None
    delayed_by: tuple[str, ...]

    @property
    def in_time(self) -> bool:
        """Whether it meets its deadline, whatever happens."""
        return self.response_ns is not None and self.response_ns <= self.message.due_in_ns


class InUnits:
    """What is computed with of a message, in units.

    Args:
        place: among those that were given.
        message: what is sent.
        rates: of the bus.
    """

    def __init__(self, place: int, message: PeriodicMessage, rates: BitRates) -> None:
        self.place, self.message, self.key = place, message, message.key()
        self.least, self.length = rates.duration(message.least_length()), rates.duration(message.frame_length())
        times = message.offset_ns, message.period_ns, message.jitter_ns
        self.offset, self.period, self.jitter = map(rates.units, times)


def in_order(messages: Sequence[PeriodicMessage], rates: BitRates) -> list[InUnits]:
    """Return messages in order of priority.

    Raises:
        ValueError: two messages have one identifier.
    """
    order = sorted((InUnits(place, each, rates) for place, each in enumerate(messages)), key=lambda each: each.key)
    for first, second in pairwise(order):
        if first.key == second.key:
            both = f"{first.message.name!r} and {second.message.name!r}"
            raise FieldError("identifier", f"{both} have {first.message.identifier:#x}, expected one each")
    return order


def response_times(
    messages: Sequence[PeriodicMessage], rates: BitRates, errors: ErrorBursts | None = None, *, terms: int = MOST_TERMS
) -> list[ResponseTime]:  # fmt: skip
    r"""Return the bound of every message, in order of priority.

    Of message m, with :math:`C` the longest frames with intermission, T periods, J jitters and hp(m) the messages that win over
    it,

    .. math::
        B_m = \max_{k \in lp(m)} C_k,\qquad
        t_m = E(t_m) + B_m + \sum_{k \in hp(m) \cup m} \lceil (t_m + J_k) / T_k \rceil\, C_k

        w_m(q) = E(w_m(q) + C_m) + B_m + q C_m + \sum_{k \in hp(m)} \lceil (w_m(q) + J_k + \tau_{bit}) / T_k \rceil\, C_k

        R_m = \max_{0 \le q < Q_m} J_m + w_m(q) - q T_m + C_m,\qquad Q_m = \lceil (t_m + J_m) / T_m \rceil.

    Every instance of the busy period counts, not the first alone: the analysis of 1994 left out that a message may push its next
    instance. That no node becomes error passive is assumed: one that is waits 8 bits longer behind a frame of its own, so that
    frames of a lower priority block it again.

    Args:
        messages: all that is sent on the bus; each node queues by priority.
        rates: of the bus.
        errors: how many errors there may be; None: none.
        terms: so many are added up for all messages together; those that are left then have no bound.

    Raises:
        ValueError: two messages have one identifier.

    >>> abc = [PeriodicMessage(name=n, identifier=i, length=7, period_ns=t) for i, (n, t) in
    ...        enumerate([("A", 2_500_000), ("B", 3_500_000), ("C", 3_500_000)])]
    >>> [found.intermission_ns / 1e6 for found in response_times(abc, BitRates(125_000))]
    [2.0, 3.0, 3.5]
    """
    known = in_order(messages, rates)
    found, load, left = [], Fraction(0), terms
    for place, own in enumerate(known):
        higher = known[:place]
        blocking = max((other.length for other in known[place + 1 :]), default=0)
        load += Fraction(own.length, own.period)
        response, left = _slowest(own, higher, blocking, load, rates, errors, left)
        found.append(
            ResponseTime(
                message=own.message,
                frame_ns=rates.ns(own.length),
                blocking_ns=rates.ns(blocking),
                response_ns=None if response is None else rates.ns(response - INTERMISSION * rates.bit),
                intermission_ns=None if response is None else rates.ns(response),
                delayed_by=tuple(other.message.name for other in higher),
            )
        )
    return found


def _slowest(
    own: InUnits, higher: Sequence[InUnits], blocking: int, load: Fraction, rates: BitRates, errors: ErrorBursts | None, left: int
) -> tuple[int | None, int]:  # fmt: skip
    """Return the largest response time in units, None without a bound, and how many of so many terms are left."""
    of_bus = [*higher, own]
    before_it = [(each.jitter, each.period, each.length) for each in higher]
    of_all = [*before_it, (own.jitter, own.period, own.length)]
    per_error = 0 if errors is None else ERROR_BITS * rates.bit + max(each.length for each in of_bus)

    def lost(units: int) -> int:
        return per_error * errors.most(units, rates) if errors is not None else 0

    load += 0 if errors is None else Fraction(per_error, rates.units(errors.interval_ns))
    if load > 1 or (load == 1 and (blocking or errors or any(each.jitter for each in of_bus))):
        return None, left  # the busy period never ends
    busy, before = own.length, 0
    while busy != before:
        if (left := left - len(of_bus)) < 0:
            return None, left
        before = busy
        busy = lost(busy) + blocking + _sent(busy, of_all)
    response, queued = 0, blocking
    for q in range(_ceil(busy + own.jitter, own.period)):
        before = -1
        while queued != before:
            if (left := left - len(of_bus)) < 0:
                return None, left
            before = queued
            queued = lost(queued + own.length) + blocking + q * own.length + _sent(before + rates.bit, before_it)
        response = max(response, own.jitter + queued - q * own.period + own.length)
        queued += own.length
    return response, left


def _sent(units: int, terms: Sequence[tuple[int, int, int]]) -> int:
    """Frames of so many units, of messages by jitter, period and length: a loop of plain numbers, as a bus of 1000 has 10^6."""
    return sum([-(-(units + jitter) // period) * length for jitter, period, length in terms])


def _ceil(number: int, divisor: int) -> int:
    return -(-number // divisor)
