"""What was measured of packets: when each was sent, how long it took or that it never came, and how two clocks run apart."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from scipy import special

from transport.errors import FieldError
from transport.laws.packet import delays

Array = NDArray[np.float64]
Ages = NDArray[np.int64]

LEAST = 299
"""Of fewer packets, what happens to one in 100 may not have been seen at all, with more than 5 %: 0.99^299 = 0.0495."""


class PacketRecord(Struct, frozen=True, kw_only=True, eq=False):
    """Packets in the order in which they were sent.

    Args:
        sent_s: (n,) instants, s, not falling.
        latency_s: (n,) time on the way, s, >= 0; NaN of a packet that has not come.
        until_s: (n,) of a packet that has not come: its latency is not below this, s: a newer one came then, and the receiver
            keeps no older one, or the record ended. Infinite: it would have been seen whenever it came, so it is lost. Default:
            infinite.

    Raises:
        FieldError: names the field and the packet; too few packets name how many would do.
    """

    sent_s: Array
    latency_s: Array
    until_s: Array | None = None

    def __post_init__(self) -> None:
        n = len(self.sent_s)
        if n < LEAST:
            said = f"{n} packets, expected at least {LEAST}: of fewer, what happens to one in 100 is missed with more than 5 %"
            raise FieldError("packets", said)
        if self.latency_s.shape != (n,) or (self.until_s is not None and self.until_s.shape != (n,)):
            raise FieldError("latency_s", f"{len(self.latency_s)} of them for {n} packets")
        if not np.isfinite(self.sent_s).all():
            raise FieldError(f"sent_s[{int(np.argmin(np.isfinite(self.sent_s)))}]", "not finite")
        back = np.flatnonzero(np.diff(self.sent_s) < 0.0)
        if len(back):
            k = int(back[0]) + 1
            step = self.sent_s[k] - self.sent_s[k - 1]
            raise FieldError(f"sent_s[{k}]", f"time stamps run backwards, by {-step:.6g} s; expected packets as they were sent")
        came = ~np.isnan(self.latency_s)
        wrong = np.flatnonzero(came & ~((self.latency_s >= 0.0) & (self.latency_s < math.inf)))
        if len(wrong):
            k = int(wrong[0])
            said = f"got {self.latency_s[k]:.6g} s, expected a latency >= 0; clocks that differ need both directions"
            said += ", and of two logs the sender's stands first"
            raise FieldError(f"latency_s[{k}]", said)
        if not came.any():
            raise FieldError("latency_s", "no packet came; expected a record of both ends")

    @property
    def came(self) -> NDArray[np.bool_]:
        """(n,) whether the packet came."""
        return ~np.isnan(self.latency_s)

    @property
    def censored_s(self) -> Array:
        """(n,) by which latency a packet had not come; infinite where that says: lost."""
        return np.full(len(self.sent_s), np.inf) if self.until_s is None else self.until_s

    @property
    def period_s(self) -> float:
        """Median of the time between two packets, s."""
        return float(np.median(np.diff(self.sent_s)))


JITTER = 1.05
"""Packets whose time apart differs by less than this factor from a slot come one in every slot."""


def one_per_slot(record: PacketRecord, period_s: float) -> PacketRecord:
    """Return the first packet of every slot, where packets come more often than slots; else the record itself.

    Args:
        record: packets.
        period_s: length of a slot, s.

    Raises:
        FieldError: too few slots.
    """
    if period_s < JITTER * record.period_s:
        return record
    slots = np.floor((record.sent_s - record.sent_s[0] + 0.5 * record.period_s) / period_s)
    first = np.unique(slots, return_index=True)[1]
    if len(first) == len(slots):
        return record
    if len(first) < LEAST:
        said = f"{len(first)} slots of {period_s:g} s, in which packets depend on each other, expected at least {LEAST}"
        raise FieldError("packets", f"{said}: measure for longer")
    return PacketRecord(sent_s=record.sent_s[first], latency_s=record.latency_s[first], until_s=record.censored_s[first])


def delays_in_slots(record: PacketRecord, period_s: float, deadline_s: float) -> Ages:
    """Return after how many slots every packet came, (n,), -1 for never: the smallest j >= 0 with L <= deadline + j T.

    Args:
        record: packets.
        period_s, deadline_s: length T of a slot, and when it closes, s.
    """
    return np.where(record.came, delays(np.where(record.came, record.latency_s, 0.0), period_s, deadline_s), -1)


def ages_of(record: PacketRecord, period_s: float, deadline_s: float) -> Ages:
    """Return the age of the newest packet that has come, slot by slot, from the first slot that has one on.

    Args:
        record: packets, one in every slot.
        period_s, deadline_s: length of a slot, and when it closes, s.
    """
    delays = delays_in_slots(record, period_s, deadline_s)
    packets = np.arange(len(delays))
    newest = np.full(len(delays), -1, dtype=np.int64)
    slots = packets + delays
    inside = (delays >= 0) & (slots < len(delays))
    np.maximum.at(newest, slots[inside], packets[inside])
    newest = np.maximum.accumulate(newest)
    return (packets - newest)[newest >= 0]


PIECES = 32
SEEN = 1e-5
"""A slope is a drift where chance alone gives it with less than this probability."""


class Drift(NamedTuple):
    """Of the receiver's clock against the sender's, s per s, with the half width of its 95 % interval; whether it is seen."""

    slope: float
    half_width: float
    seen: bool


def drift_of(sent_s: Array, difference_s: Array) -> Drift:
    """Estimate the drift between two clocks.

    A packet sent at s of one clock came at r of the other: r - s = L + offset + drift s, L >= least latency. The smallest of r -
    s in each of 32 pieces of the record lie near a line, whose slope is the drift (Paxson 1998), by the median of Theil and Sen;
    whether there is one says Kendall's rank test. The offset cannot be seen in one direction: of both it is half the difference
    of the smallest ones, if the least latency is the same in both.

    Args:
        sent_s: (n,) instants at the sender's clock.
        difference_s: (n,) received minus sent, NaN of what did not come.
    """
    span = float(sent_s[-1] - sent_s[0])
    piece = (
        np.minimum(((sent_s - sent_s[0]) / span * PIECES).astype(np.int64), PIECES - 1)
        if span > 0.0
        else np.zeros(len(sent_s), int)
    )
    at, least = [], []
    for number in range(PIECES):
        here = np.flatnonzero((piece == number) & ~np.isnan(difference_s))
        if len(here):
            lowest = int(here[difference_s[here].argmin()])
            at.append(sent_s[lowest])
            least.append(difference_s[lowest])
    if len(at) < PIECES // 2:
        return Drift(0.0, np.inf, False)
    from scipy import stats  # half a second of CPU

    line = stats.theilslopes(least, at, alpha=0.95)
    seen = float(stats.kendalltau(at, least).pvalue) < SEEN
    return Drift(float(line.slope), 0.5 * float(line.high_slope - line.low_slope), seen)


def drift_and_rise(there: Drift, back: Drift) -> tuple[Drift, Drift]:
    """Return the drift of the other clock against ours, and by how much the least latency rises in both directions, s per s.

    A drift raises the differences of one direction as it lowers those of the other; a queue that fills raises both. Either is
    seen where chance alone, as good as normal, gives it with less than `SEEN`.

    Args:
        there: of the differences at the other clock.
        back: of those at ours.
    """
    half = 0.5 * math.hypot(there.half_width, back.half_width)
    surely = half * float(special.ndtri(0.5 * SEEN) / special.ndtri(0.025))
    slopes = 0.5 * (there.slope - back.slope), 0.5 * (there.slope + back.slope)
    drift, rise = (Drift(slope, half, abs(slope) > surely) for slope in slopes)
    return drift, rise


def without_drift(sent_s: Array, difference_s: Array, drift: Drift) -> Array:
    """Return received minus sent as if both clocks ran alike; the first difference stays as it was.

    Args:
        sent_s, difference_s: see `drift_of`.
        drift: what was estimated.
    """
    return np.asarray(difference_s - drift.slope * (sent_s - sent_s[0]), dtype=np.float64)


def offset_of(there_s: Array, back_s: Array) -> float:
    """Return how far the other clock is ahead, s, if the least latency is the same in both directions.

    Args:
        there_s: received (other clock) minus sent (ours), NaN of what did not come.
        back_s: received (ours) minus sent (other clock).
    """
    return 0.5 * (float(np.nanmin(there_s)) - float(np.nanmin(back_s)))
