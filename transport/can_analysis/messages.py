"""A message that comes again and again, as the analysis of a bus takes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from transport.can_bus_model.bit_rates import BitRates
from transport.can_bus_model.bits import FrameLength
from transport.can_bus_model.frame import CanFrame, arbitration_key
from transport.can_bus_model.worst_case import longest_frame
from transport.errors import FieldError


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodicMessage:
    """A message of a node that queues by priority.

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

    def __post_init__(self) -> None:
        self.key()
        self.frame_length()
        if self.period_ns <= 0:
            raise FieldError("period_ns", f"{self.period_ns}, expected more than 0")
        if self.jitter_ns < 0:
            raise FieldError("jitter_ns", f"{self.jitter_ns} is negative")

    def key(self) -> int:
        """Return its place in arbitration: the smaller one wins."""
        return arbitration_key(CanFrame(identifier=self.identifier, extended=self.extended))

    def frame_length(self) -> FrameLength:
        """Return the length of its longest frame, with intermission."""
        if self.bits is not None:
            return self.bits
        return longest_frame(self.length, extended=self.extended, fd=self.fd, bitrate_switch=self.bitrate_switch)

    @property
    def due_in_ns(self) -> int:
        """Its deadline, ns."""
        return self.period_ns if self.deadline_ns is None else self.deadline_ns


def bus_load(messages: Sequence[PeriodicMessage], rates: BitRates) -> Fraction:
    r"""Return the share of time that the messages need: :math:`\sum C_m / T_m`."""
    shares = (Fraction(rates.duration(each.frame_length()), rates.units(each.period_ns)) for each in messages)
    return sum(shares, start=Fraction(0))
