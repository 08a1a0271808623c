"""Packets of many runs at once: what receivers under one packet law hold in every slot, from the streams of the single runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray

from transport.laws.latency import Latency, LatencyTrace

Seconds = NDArray[np.float64]
Flags = NDArray[np.bool_]
Slots = NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class SlotTimes:
    """How latencies become slots, see `transport.laws.packet_draws.PacketDraws`.

    Args:
        period_s: length of a slot, s.
        deadline_s: when a slot closes after it began, s.
        tolerance: of a latency that ends with a slot, in slots.
        latest: largest delay, slots.
    """

    period_s: float
    deadline_s: float
    tolerance: float
    latest: int

    def delays(self, latency_s: Seconds) -> NDArray[np.int64]:
        """Return the delays in slots of finite latencies, the same shape."""
        slots = np.ceil((latency_s - self.deadline_s) / self.period_s - self.tolerance)
        return np.clip(slots, 0, self.latest).astype(np.int64)


def quantiles(law: Latency, levels: Seconds) -> Seconds:
    """Return what the law's sampler gives at some levels of [0, 1), the same shape, s."""
    if isinstance(law, LatencyTrace):
        recorded = np.array(sorted(v for v in law.values_s if np.isfinite(v)) or [np.inf])
        return recorded.take((levels * len(recorded)).astype(np.intp))
    at, values = np.array(law.levels), np.array(law.values_s)
    rise, step = np.diff(values), np.diff(at)
    slopes = np.divide(rise, step, out=np.zeros(len(step)), where=step > 0)
    i = np.searchsorted(at, levels, side="right") - 1
    return np.asarray(values.take(i) + (levels - at.take(i)) * slopes.take(i))


def in_order(law: Latency, levels: Seconds) -> Seconds | None:
    """Return the latencies of the packets of all slots, (slots, runs), s; None of a trace that ends before.

    Args:
        law: of the latencies.
        levels: numbers of [0, 1), (slots, runs).
    """
    if not isinstance(law, LatencyTrace):
        return quantiles(law, levels)
    values = np.array(list(islice(cycle(law.values_s) if law.repeat else law.values_s, len(levels))))
    return None if len(values) < len(levels) else np.broadcast_to(values[:, None], levels.shape)


def newest_received(
    sent: Sequence[Flags], delays: Sequence[NDArray[np.int64]], *, reordering: bool, queue: int
) -> tuple[Slots, Flags]:
    """Return the slot of the newest packet that has come, (slots, runs), -1 before the first, and in which runs known, (runs,).

    The numbers of a slot, the order of every sum and the rounding of every latency to slots are those of `PacketDraws`.

    Args:
        sent: of every slot, whether the packet leaves, and whether a copy follows it; (slots, runs) each.
        delays: of both, slots, (slots, runs) each.
        reordering: whether a packet may overtake an earlier one.
        queue: packets in flight at most; a run in which one more leaves is not counted.
    """
    slots, runs = sent[0].shape
    newest = np.full((slots, runs), -1, dtype=np.int32)
    landing = np.zeros((slots, runs), dtype=np.int32)  # how many arrive
    flying, last = np.zeros(runs, dtype=np.int64), np.zeros(runs, dtype=np.int64)
    whole = np.ones(runs, dtype=np.bool_)
    for k in range(slots):
        if k:
            flying -= landing[k - 1]
        for leaves, delay in zip((s[k] for s in sent), (d[k] for d in delays)):
            at = delay + k
            if not reordering:
                at = np.maximum(at, last)
                last = np.where(leaves, at, last)
            whole &= ~(leaves & (flying >= queue))
            flying += leaves
            runs_in_time = np.flatnonzero(leaves & (at < slots))
            arrives = at.take(runs_in_time)
            newest[arrives, runs_in_time] = k
            landing[arrives, runs_in_time] += 1
    return np.maximum.accumulate(newest, axis=0), whole
