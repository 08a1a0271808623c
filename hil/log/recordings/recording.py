"""What a file says of packets on their way, before anybody judges it: instants of sending and of receiving, by direction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.errors import HilError
from transport.errors import FieldError
from transport.law_fit.packet_record import Drift, PacketRecord, drift_and_rise, drift_of, offset_of, without_drift

Array = NDArray[np.float64]

ROUND_TRIP: Final = "round trip"
THERE, BACK = "sc", "ca"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Way:
    """Packets of one direction.

    Args:
        sent_s: (n,) instants at the sender's clock.
        difference_s: (n,) received, at the receiver's clock, minus sent; NaN of what did not come.
        until_s: see `transport.law_fit.packet_record.PacketRecord`; None: what did not come was lost.
    """

    sent_s: Array
    difference_s: Array
    until_s: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """What one or two files hold.

    Args:
        source: the files, for messages.
        ways: "sc", "ca" or "round trip" to its packets.
        clocks: clocks that took the time stamps: 1, or 2 that may run apart.
        notes: what the reader found worth a line.
    """

    source: str
    ways: Mapping[str, Way]
    clocks: int
    notes: tuple[str, ...] = field(default=())


def packet_records(recording: Recording, *, halve: bool = False) -> tuple[dict[str, PacketRecord], tuple[str, ...]]:
    """Return latencies by direction, with what was done about clocks, in words.

    Args:
        recording: what was read.
        halve: take half of a round trip for each direction.

    Raises:
        HilError: latencies are negative, time stamps run backwards, or there are too few packets; the message has the remedy.
    """
    ways, notes = dict(recording.ways), list(recording.notes)
    if recording.clocks == 2:
        drifts = {name: _drift(way) for name, way in ways.items()}
        if THERE in ways and BACK in ways:
            drift, rise = drift_and_rise(drifts[THERE], drifts[BACK])
            drifts = {THERE: drift, BACK: drift._replace(slope=-drift.slope)}
            if rise.seen:
                size = f"{rise.slope * 1e6:.3g} us per s (95 %: +- {rise.half_width * 1e6:.2g})"
                notes.append(
                    f"the least latency rises by {size} in the mean of both directions, which no clock does: it stays in, and a "
                    "drift is told from it if it is the same in both"
                )
        for name, way in ways.items():
            ways[name] = _straight(name, way, drifts[name], notes)
        if THERE in ways and BACK in ways:
            offset = offset_of(ways[THERE].difference_s, ways[BACK].difference_s)
            shifts = {THERE: -offset, BACK: offset}
            ways = {name: replace(way, difference_s=way.difference_s + shifts[name]) for name, way in ways.items()}
            notes.append(f"offset between the clocks {offset:.6g} s, taken out: the least latency is the same in both directions")
        else:
            said = "would shift every latency, and cannot be seen; a latency that grows would be taken for a drift"
            notes.append(f"one direction: an offset between the two clocks {said}")
    if halve:
        if ROUND_TRIP not in ways:
            raise HilError(f"{recording.source}: --halve: these are no round trips, but {' and '.join(ways)}")
        whole = ways.pop(ROUND_TRIP)
        ways |= {name: Way(sent_s=whole.sent_s, difference_s=whole.difference_s / 2.0) for name in (THERE, BACK)}
        notes.append("each direction is half of a round trip, by choice: that they are equal, and independent, is assumed")
    found = {}
    for name, way in ways.items():
        try:
            found[name] = PacketRecord(sent_s=way.sent_s, latency_s=way.difference_s, until_s=way.until_s)
        except FieldError as error:
            raise HilError(f"{recording.source}: {name}: {error.field}: {error.message}") from error
    return found, tuple(notes)


def _drift(way: Way) -> Drift:
    """Return the drift in one direction, none where too few packets came."""
    none = len(way.sent_s) < 2 or np.isnan(way.difference_s).all()
    return Drift(0.0, np.inf, False) if none else drift_of(way.sent_s, way.difference_s)


def _straight(name: str, way: Way, drift: Drift, notes: list[str]) -> Way:
    if not np.isfinite(drift.half_width):
        return way
    said = f"{name}: drift between the clocks {drift.slope * 1e6:.3g} ppm (95 %: +- {drift.half_width * 1e6:.2g})"
    notes.append(f"{said}, taken out" if drift.seen else f"{said}: none is seen, none is taken out")
    if not drift.seen:
        return way
    return replace(way, difference_s=without_drift(way.sent_s, way.difference_s, drift))
