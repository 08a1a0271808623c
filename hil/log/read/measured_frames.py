"""The frames of a run at the instants that were measured, in the order of time, and never all of them in memory."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.errors import HilError
from hil.log.append_column import AppendColumn, pieces
from hil.log.read.run import Run
from hil.log.records import TIME_FIELD
from hil.log.topics import CONTROL, TIMING

TOGETHER: Final = 4096
"""Frames that are read at a time."""

MOST_HELD: Final = 200_000
"""Frames that wait in memory for one that stands behind them in the log and before them in time."""

Slots: TypeAlias = npt.NDArray[np.int64]


def measured_frames(run: Run, topic: str) -> Iterator[tuple[int, bytes]]:
    """Give every frame of a topic with its instant in session time, ns: nominal plus what was measured of that slot.

    The order is that of time. The log may have another: an answer that came too late stands behind the next question. How far
    an instant falls behind an earlier one at most is found first; so a frame waits only until none can come before it.

    Args:
        run: the run.
        topic: `/link/sensor` or `/link/control`.

    Raises:
        HilError: the log is so far out of order that more than `MOST_HELD` frames would have to wait.
    """
    measured = _lateness(run, topic)
    behind = _farthest_behind(run, topic, measured)
    held: list[tuple[int, int, bytes]] = []
    newest, number = -(1 << 62), 0
    for piece in run.pieces(topic, TOGETHER):
        for t_ns, data in zip((piece[TIME_FIELD] + measured(piece["slot"])).tolist(), piece["data"].tolist()):
            newest = max(newest, t_ns)
            heapq.heappush(held, (t_ns, number, bytes(data)))
            number += 1
            while held and held[0][0] <= newest - behind:
                t, _, frame = heapq.heappop(held)
                yield t, frame
            if len(held) > MOST_HELD:
                raise HilError(
                    f"{topic}: the frames are out of order by {behind / 1e9:g} s; more than {MOST_HELD} would have to wait in "
                    "memory, and no session writes such a log"
                )
    while held:
        t, _, frame = heapq.heappop(held)
        yield t, frame


def _farthest_behind(run: Run, topic: str, measured: Callable[[Slots], Slots]) -> int:
    """Return how far an instant lies before the latest of those that stand before it in the log, ns."""
    newest, most = -(1 << 62), 0
    for piece in pieces(run.numbers(topic), TOGETHER):
        at = piece[TIME_FIELD] + measured(piece["slot"])
        latest = np.maximum(np.maximum.accumulate(at), newest)
        most = max(most, int((latest - at).max()))
        newest = int(latest[-1])
    return most


def _lateness(run: Run, topic: str) -> Callable[[Slots], Slots]:
    """Return how much after its nominal instant a frame of a slot came, ns; 0 for a slot that was not timed."""
    numbers, delays, last, ordered = AppendColumn(np.int64), AppendColumn(np.int64), -(1 << 62), True
    for piece in pieces(run.numbers(TIMING.name), TOGETHER):
        late_us: npt.NDArray[np.float64] = piece["lateness_us"]
        if topic == CONTROL.name:
            late_us = late_us + np.nan_to_num(piece["round_trip_us"])
        delays.extend(np.round(late_us * 1e3).astype(np.int64))
        own = piece["slot"].astype(np.int64)
        numbers.extend(own)
        ordered = ordered and own[0] > last and not (own[1:] <= own[:-1]).any()
        last = int(own[-1])
    slots, late_ns = numbers.array(), delays.array()
    if not ordered:
        order = np.argsort(slots, kind="stable")
        late_ns, slots = late_ns[order], slots[order]

    def of(asked: Slots) -> Slots:
        if not len(slots):
            return np.zeros(len(asked), np.int64)
        at = np.maximum(np.searchsorted(slots, asked, side="right") - 1, 0)
        return np.where(slots[at] == asked, late_ns[at], 0)

    return of
