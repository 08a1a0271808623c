"""The sending side of a participant of a bus that takes time: a thread that hands a frame out when it has got through."""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Condition, Thread
from time import monotonic, monotonic_ns
from typing import Final

from transport.can_bus_model.bit_rates import BitRates
from transport.can_bus_model.bits import CanFrame
from transport.errors import FieldError
from transport.links.shared_bus import Ended, Seen, SharedBus

MOST_WAITING: Final = 1024
"""Frames that a participant may have sent and that have not got through."""

_ON_THE_BUS: Final = 16  # of these: enough that the bus is never idle for want of a frame, and few to write down each time

_IN_VAIN_S: Final = 0.005  # no node acknowledges: the bus repeats without being looked at
_SWEEP_S: Final = 0.5
_IDLE_S: Final = 0.25

Deliver = Callable[[object, int], None]


def rate(said: object, field: str) -> int:
    """Return a bit rate that was written as a number or as text, in bit/s.

    Raises:
        ValueError: it is none.

    >>> rate("500k", "bitrate"), rate("2M", "dbitrate"), rate(125000, "bitrate"), rate("83.333k", "bitrate")
    (500000, 2000000, 125000, 83333)
    """
    text = str(said).strip()
    scale = {"k": 1_000, "M": 1_000_000}.get(text[-1:], 1)
    with suppress(ValueError):
        number = float(text[:-1] if scale > 1 else text) * scale
        if number == round(number) and not isinstance(said, bool):
            return round(number)
    raise FieldError(field, f"{said!r:.40}, expected bit/s such as 500000, 500k or 2M")


def timed_rates(timed: object, bitrate: object, dbitrate: object) -> BitRates | None:
    """Return the rates of a bus that takes time, None for one that does not; a rate that times nothing is warned of.

    Raises:
        ValueError: a rate that no controller has, or none.
    """
    if timed in (False, 0, None):
        if bitrate is not None:
            warnings.warn("hil: bitrate times nothing on this bus; add timed=True for a bus that takes time", stacklevel=3)
        return None
    if timed is not True and timed != 1:
        raise FieldError("timed", f"{timed!r:.40}, expected True or False")
    if bitrate is None:
        raise FieldError("bitrate", "missing; a bus that takes time has one, such as 500k")
    return BitRates(rate(bitrate, "bitrate"), None if dbitrate is None else rate(dbitrate, "dbitrate"))


class TimedSender:
    """The frames of one participant on their way to the bus.

    Args:
        directory: where the participants of the bus meet.
        rates: of this participant.
        deliver: called with (item, CLOCK_MONOTONIC ns of the end of its EOF) when a frame got through, from a thread of its own.
        changed: called with what was seen when the error state of this participant has changed.

    Raises:
        TransportError: the state of the bus cannot be had.
    """

    def __init__(self, directory: Path, rates: BitRates, deliver: Deliver, changed: Callable[[Seen], None]) -> None:
        self._deliver, self._changed = deliver, changed
        self._items: dict[int, object] = {}
        self._bus = SharedBus(directory, rates, self._ended)
        self._backlog: deque[tuple[CanFrame, int]] = deque()
        self._tag = self._waiting = 0
        self._next_ns: int | None = None
        self._state: str = "active"
        self._swept = monotonic()
        self._more = Condition()
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

    def _ended(self, each: Ended) -> None:
        if each.sent and each.tag in self._items:
            self._deliver(self._items.pop(each.tag), each.end_ns)

    def _take(self, seen: Seen) -> None:
        self._waiting = seen.waiting
        earliest = monotonic_ns() + round(_IN_VAIN_S * 1e9) if seen.in_vain else 0
        self._next_ns = None if seen.next_ns is None else max(seen.next_ns, earliest)
        if seen.state != self._state:
            self._state = seen.state
            self._changed(seen)

    def _run(self) -> None:
        with self._more:
            while not self._closed:
                if not self._items:
                    self._more.wait(_IDLE_S)
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
                    self._bus.sweep()

    def close(self) -> None:
        """Leave the bus; what waits is not sent."""
        with self._more:
            if self._closed:
                return
            self._closed = True
            self._more.notify_all()
        self._thread.join(1.0)
        self._bus.close()
