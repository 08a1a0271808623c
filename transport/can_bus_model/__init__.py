"""A CAN (FD) bus that takes time: the bits of a frame, who wins the bus, what an error costs, and who is still on it.

Here are the frames that its nodes send, its two bit rates as a controller's clock divides them, and what other nodes send:
messages that come again and again, or a recording, in the order in which they are queued.

A controller divides a clock of 80 MHz: a bit is a whole number of its 12.5 ns. In units of half a nanosecond, instants in
nanoseconds and bits of every rate are whole numbers: nothing of the bus's time is ever rounded, on no machine.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct

from transport.errors import FieldError
from transport.wire import FD_LENGTHS

if TYPE_CHECKING:
    import numpy as np

BASE_MOST: Final = 0x7FF
EXTENDED_MOST: Final = 0x1FFF_FFFF

CLOCK_HZ: Final = 80_000_000
UNITS_PER_NS: Final = 2
_UNITS_PER_CYCLE: Final = 25  # 12.5 ns
_SLOWEST: Final = 5_000
_FASTEST: Final = 1_000_000
_FASTEST_DATA: Final = 10_000_000


class CanFrame(Struct, frozen=True, kw_only=True):
    """A data or remote frame of classic CAN or CAN FD.

    Args:
        identifier: 11 bits, or 29 where ``extended``.
        data: 0 to 8 bytes; with ``fd`` one of 0 to 8, 12, 16, 20, 24, 32, 48, 64.
        extended: whether the identifier has 29 bits.
        remote: a request without data; classic CAN only.
        dlc: length that a remote frame asks for; None otherwise.
        fd: CAN FD.
        bitrate_switch: whether data and CRC travel at the data bit rate; with ``fd`` only.
        error_state: the ESI bit: the sender is error passive; with ``fd`` only.

    Raises:
        ValueError: a value that no frame has; the message begins with its field.
    """

    identifier: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    dlc: int | None = None
    fd: bool = False
    bitrate_switch: bool = False
    error_state: bool = False

    def __post_init__(self) -> None:
        most = EXTENDED_MOST if self.extended else BASE_MOST
        if not 0 <= self.identifier <= most:
            bits = 29 if self.extended else 11
            raise FieldError("identifier", f"{self.identifier:#x}, expected 0 to {most:#x} ({bits} bits)")
        if self.remote and (self.fd or self.data or not 0 <= (self.dlc or 0) <= 8):
            raise FieldError("remote", "a remote frame is a classic one, without data and with a DLC of 0 to 8")
        if not self.remote and self.dlc is not None:
            raise FieldError("dlc", f"{self.dlc}, expected none: only a remote frame asks for a length")
        if self.fd and len(self.data) not in FD_LENGTHS:
            allowed = ", ".join(map(str, FD_LENGTHS))
            raise FieldError("data", f"{len(self.data)} bytes, expected one of {allowed} in a CAN FD frame")
        if not self.fd and len(self.data) > 8:
            raise FieldError("data", f"{len(self.data)} bytes, expected at most 8 in a classic frame")
        if not self.fd and (self.bitrate_switch or self.error_state):
            raise FieldError("bitrate_switch", "a classic frame has neither the BRS nor the ESI bit, expected fd = true")

    @property
    def length_code(self) -> int:
        """The four bits of the DLC."""
        return (self.dlc or 0) if self.remote else FD_LENGTHS.index(len(self.data))


def arbitration_key(frame: CanFrame) -> int:
    """Return the bits that decide the arbitration, as one number: of two frames the smaller one wins.

    A base frame wins over an extended one with the same first 11 bits, a data frame over a remote one.

    >>> base, remote = CanFrame(identifier=1), CanFrame(identifier=1, remote=True)
    >>> extended = CanFrame(identifier=1 << 18, extended=True)
    >>> arbitration_key(base) < arbitration_key(remote) < arbitration_key(extended)
    True
    """
    if frame.extended:
        first, second = frame.identifier >> 18, frame.identifier & 0x3FFFF
        return first << 21 | 0b11 << 19 | second << 1 | frame.remote
    return frame.identifier << 21 | frame.remote << 20


class FrameLength(NamedTuple):
    """Bits of a frame with its intermission.

    Attributes:
        nominal: bits at the nominal rate.
        data: bits at the data rate.
    """

    nominal: int
    data: int = 0


class BitRates(Struct, frozen=True):
    """Nominal and data bit rate of a bus.

    Args:
        bitrate: nominal rate, bit/s: 5,000 to 1,000,000, and 80 MHz over a whole number, to the nearest bit/s.
        dbitrate: data rate of CAN FD, bit/s, at least ``bitrate`` and at most 10,000,000; by default the nominal one.

    Raises:
        ValueError: no controller has such a rate; the message names the nearest one.

    >>> rates = BitRates(500_000, 2_000_000)
    >>> rates.ns(rates.duration(FrameLength(29, 550)))
    333000
    """

    bitrate: int
    dbitrate: int | None = None

    def __post_init__(self) -> None:
        _check("bitrate", self.bitrate, _SLOWEST, _FASTEST)
        if self.dbitrate is not None:
            _check("dbitrate", self.dbitrate, self.bitrate, _FASTEST_DATA)

    @property
    def bit(self) -> int:
        """One bit at the nominal rate, in units."""
        return _cycles(self.bitrate) * _UNITS_PER_CYCLE

    @property
    def data_bit(self) -> int:
        """One bit at the data rate, in units."""
        return _cycles(self.dbitrate or self.bitrate) * _UNITS_PER_CYCLE

    def duration(self, length: FrameLength) -> int:
        """Return how long so many bits last, in units."""
        return length.nominal * self.bit + length.data * self.data_bit

    @staticmethod
    def units(ns: int) -> int:
        """Return an instant or a duration in units."""
        return ns * UNITS_PER_NS

    @staticmethod
    def ns(units: int) -> int:
        """Return the first nanosecond at or after so many units."""
        return -(-units // UNITS_PER_NS)


def _cycles(rate: int) -> int:
    return (CLOCK_HZ + rate // 2) // rate


def _nearest(rate: int, least: int, most: int) -> int:
    bounded: Iterable[int] = (_cycles(min(max(rate, least), most)) + step for step in (-1, 0, 1))
    possible = [round(CLOCK_HZ / cycles) for cycles in bounded if cycles > 0]
    return min((each for each in possible if least <= each <= most), key=lambda each: abs(each - rate), default=least)


def _check(field: str, rate: int, least: int, most: int) -> None:
    if not least <= rate <= most:
        nearest = _nearest(rate, least, most)
        raise FieldError(field, f"{rate} bit/s, expected {least} to {most}; the nearest possible is {nearest}")
    if round(CLOCK_HZ / _cycles(rate)) != rate:
        nearest = _nearest(rate, least, most)
        raise FieldError(field, f"{rate} bit/s: no whole part of {CLOCK_HZ} Hz; the nearest possible is {nearest}")


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


class Periodic(Struct, frozen=True, kw_only=True):
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
