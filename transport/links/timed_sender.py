"""The sending side of a participant of a bus that takes time: a thread that hands a frame out when it has got through."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Condition, Thread
from time import monotonic, monotonic_ns
from typing import Final

from transport.can_bus_model import BitRates, CanFrame
from transport.can_bus_model.disturbances import BusFault
from transport.can_bus_model.node import State
from transport.links.held_bus import Ended, StateChange
from transport.links.shared_bus import Seen, SharedBus

MOST_WAITING: Final = 1024
"""Frames that a participant may have sent and that have not got through."""

_ON_THE_BUS: Final = 16  # of these: enough that the bus is never idle for want of a frame, and few to write down each time

_IN_VAIN_S: Final = 0.005  # no node acknowledges: the bus repeats without being looked at
_SWEEP_S: Final = 0.5
_IDLE_S: Final = 0.25
_MOST_INTERVALS: Final = 16

FrameCallback = Callable[[object, int, bool], None]


class TimedSender:
    """The frames of one participant on their way to the bus.

    Args:
        directory: where the participants of the bus meet.
        rates: of this participant.
        deliver: called with (item, CLOCK_MONOTONIC ns of the end of its EOF, see `Ended.alone`) when a frame got through, from a
            thread of its own.
        destroyed: called with (item, bit, likewise) when a frame was destroyed at a bit; it is sent again.
        changed: called with (the state before, the change) when the error state of this participant has changed.
        others_changed: called when that of another one has.
        restart_s: from bus-off to when recovery begins, s; None: it stays off.

    Raises:
        TransportError: the state of the bus cannot be had.
    """

    def __init__(
        self, directory: Path, rates: BitRates, deliver: FrameCallback, destroyed: FrameCallback,
        changed: Callable[[State, StateChange], None], others_changed: Callable[[], None], restart_s: float | None,
    ) -> None:  # fmt: skip
        self._deliver, self._destroyed, self._changed, self._restart_s = deliver, destroyed, changed, restart_s
        self._items: dict[int, object] = {}
        self._restart_at: float | None = None
        self._changed_ns = 0
        self._off_intervals: deque[tuple[int, int | None]] = deque(maxlen=_MOST_INTERVALS)  # in which it was off the bus
        self._backlog: deque[tuple[CanFrame, int]] = deque()
        self._tag = self._waiting = 0
        self._next_ns: int | None = None
        self._state: State = "active"
        self._swept = monotonic()
        self._more = Condition()
        self._bus = SharedBus(directory, rates, self._ended, self._own_changed, others_changed)
        self._closed = False
        self._policy = os.sched_getscheduler(0)
        self._thread = Thread(target=self._run, name="hil bus", daemon=True)
        self._thread.start()

    def send(self, frame: CanFrame, item: object, timeout_s: float) -> bool:
        """Queue a frame; return False if the buffer stays full for so long.

        Args:
            frame: what is sent.
            item: what `deliver` gets.
            timeout_s: how long to wait for room, s.
        """
        self._be_as_urgent()
        with self._more:
            if not self._more.wait_for(lambda: self._closed or len(self._items) < MOST_WAITING, timeout_s) or self._closed:
                return False
            self._tag += 1
            self._items[self._tag] = item
            self._backlog.append((frame, self._tag))
            self._fill()
            self._more.notify_all()
        return True

    def look(self) -> Seen:
        """Return the error state and counters now."""
        with self._more:
            seen = self._bus.look()
            self._take(seen)
            return seen

    def was_off(self, at_ns: int) -> bool:
        """Return whether it was off the bus at an instant of CLOCK_MONOTONIC; up to the last look."""
        return any(first <= at_ns and (end is None or at_ns < end) for first, end in self._off_intervals)

    def plan(self, faults: Sequence[BusFault], seed: int, senders: Sequence[Sequence[int]]) -> None:
        """Replace what is wrong with the bus when, see `SharedBus.plan`."""
        with self._more:
            self._take(self._bus.plan(faults, seed, senders))

    def _be_as_urgent(self) -> None:
        """Give the thread the scheduling of the thread that sends, as of a process that keeps time."""
        policy = os.sched_getscheduler(0)
        if policy != self._policy and self._thread.native_id is not None:
            self._policy = policy
            with suppress(OSError):
                os.sched_setscheduler(self._thread.native_id, policy, os.sched_getparam(0))

    def _fill(self) -> None:
        """Hand frames to the bus, in the order in which they were sent."""
        if self._backlog and self._waiting < _ON_THE_BUS:
            some = [self._backlog.popleft() for _ in range(min(len(self._backlog), _ON_THE_BUS - self._waiting))]
            self._take(self._bus.queue(some))

    def _ended(self, ended: Ended) -> None:
        if ended.tag not in self._items:
            return
        if ended.error_bit is None:
            self._deliver(self._items.pop(ended.tag), ended.end_ns, ended.alone)
        else:
            self._destroyed(self._items[ended.tag], ended.error_bit, ended.alone)

    def _take(self, seen: Seen) -> None:
        self._waiting = seen.waiting
        earliest = monotonic_ns() + round(_IN_VAIN_S * 1e9) if seen.in_vain else 0
        self._next_ns = None if seen.next_ns is None else max(seen.next_ns, earliest)

    def _own_changed(self, change: StateChange) -> None:
        if change.at_ns > self._changed_ns:
            before, self._state, self._changed_ns = self._state, change.state, change.at_ns
            if before == "off":
                self._off_intervals.append((self._off_intervals.pop()[0], change.at_ns))
            if change.state == "off":
                self._off_intervals.append((change.at_ns, None))
            waits = change.state == "off" and self._restart_s is not None
            self._restart_at = monotonic() + (self._restart_s or 0.0) if waits else None
            self._changed(before, change)
            self._more.notify_all()

    def _run(self) -> None:
        with self._more:
            while not self._closed:
                if self._restart_at is not None:
                    left_s = self._restart_at - monotonic()
                    if left_s > 0:
                        self._more.wait(left_s)
                    else:
                        self._restart_at = None
                        self._take(self._bus.restart())
                elif not self._items:
                    self._more.wait(_IDLE_S)
                    if self._state == "off":
                        self._take(self._bus.look())
                else:
                    due = self._next_ns
                    pause = _IN_VAIN_S if due is None else (due - monotonic_ns()) / 1e9
                    if pause > 0:
                        self._more.wait(min(pause, _IDLE_S))
                        continue
                    self._take(self._bus.look())
                    self._fill()
                    self._more.notify_all()
                if monotonic() - self._swept > _SWEEP_S:
                    self._swept = monotonic()
                    self._take(self._bus.sweep())

    def close(self) -> None:
        """Leave the bus; what waits is not sent."""
        with self._more:
            if self._closed:
                return
            self._closed = True
            self._more.notify_all()
        self._thread.join(1.0)
        self._bus.close()
