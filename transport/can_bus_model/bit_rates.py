"""The two bit rates of a bus, as a controller's clock divides them, and the whole numbers in which its time is counted.

A controller divides a clock of 80 MHz: a bit is a whole number of its 12.5 ns. In units of half a nanosecond, instants in
nanoseconds and bits of every rate are whole numbers: nothing of the bus's time is ever rounded, on no machine.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from msgspec import Struct

from transport.can_bus_model.bits import FrameLength
from transport.errors import FieldError

CLOCK_HZ: Final = 80_000_000
UNITS_PER_NS: Final = 2
_UNITS_PER_CYCLE: Final = 25  # 12.5 ns
_SLOWEST: Final = 5_000
_FASTEST: Final = 1_000_000
_FASTEST_DATA: Final = 10_000_000


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
