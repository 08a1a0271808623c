"""The clocks of session time, in nanoseconds, and the slots that begin on one. No other file reads a clock, or sleeps."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable
from typing import Final, Protocol

TIMER_ABSTIME = 1


class Clock(Protocol):
    """Where a kernel gets its time from."""

    def wait_until(self, t_ns: int) -> None:
        """Return when session time is at least ``t_ns`` (or a signal arrived)."""


class PacedClock:
    """Virtual time at a pace: a second of session time takes 1 / speed s, and none while it is paused.

    One thread waits on it; any other may pause it, resume it, step it, or end it. What a run computes does not depend on it.

    Args:
        speed: session time per time, above 0.
        paused: whether it waits at once, before slot 0.

    >>> clock = PacedClock(speed=1e9); clock.wait_until(5); clock.now_ns
    5
    """

    BEHIND_NS: Final = 200_000_000  # what cannot keep its pace does not hurry afterwards
    LOOK_S: Final = 0.05

    def __init__(self, speed: float = 1.0, paused: bool = False) -> None:
        self._lock = threading.Lock()
        self._speed, self._paused, self._steps, self._ended = speed, paused, 0, False
        self.now_ns = 0
        self._from = time.monotonic_ns(), 0  # an instant, and the session time then

    def wait_until(self, t_ns: int) -> None:
        while True:
            with self._lock:
                left_s = self._left_s(t_ns)
                if left_s <= 0.0:
                    self.now_ns = max(self.now_ns, t_ns)
                    return
            time.sleep(min(left_s, self.LOOK_S))

    def _left_s(self, t_ns: int) -> float:
        if self._ended:
            return 0.0
        if self._paused:
            if not self._steps:
                return self.LOOK_S
            self._steps -= 1
            return 0.0
        begun_ns, at_ns = self._from
        left_ns = begun_ns + (t_ns - at_ns) / self._speed - time.monotonic_ns()
        if left_ns < -self.BEHIND_NS:
            self._from = time.monotonic_ns(), t_ns
        return left_ns / 1e9

    @property
    def speed(self) -> float:
        """Session time per time."""
        return self._speed

    @property
    def paused(self) -> bool:
        """Whether it waits for a step."""
        return self._paused

    def set(self, *, speed: float | None = None, paused: bool | None = None) -> None:
        """Change the speed, pause or resume."""
        with self._lock:
            self._speed = self._speed if speed is None else speed
            self._paused = self._paused if paused is None else paused
            self._steps, self._from = 0, (time.monotonic_ns(), self.now_ns)

    def step(self, slots: int) -> None:
        """Pause, and let so many slots pass."""
        with self._lock:
            self._paused = True
            self._steps += slots

    def end(self) -> None:
        """Wait no more (safe in a signal handler)."""
        self._ended = True


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


_libc = ctypes.CDLL(None, use_errno=True)


class RealClock:
    """Waits on absolute ``CLOCK_MONOTONIC`` deadlines; session time 0 is ``start_ns`` on that clock.

    A timer wakes a process up some microseconds late, on a virtual machine some tens. So it is set ahead by as much as all but
    one in ten of the wake-ups before were late, `LONGEST_LEAD_NS` at most, and what is left is waited for without sleep.

    Args:
        start_ns: ``CLOCK_MONOTONIC`` instant of session time 0, ns.
    """

    LONGEST_LEAD_NS: Final = 50_000
    STEP_NS: Final = 100

    def __init__(self, start_ns: int) -> None:
        self.begin(start_ns)
        self._lead_ns = 0
        self._sleep = _libc.clock_nanosleep
        self._spec = _Timespec()

    def begin(self, start_ns: int) -> None:
        """Let session time be 0 at another instant."""
        self._start_ns = start_ns

    def wait_until(self, t_ns: int) -> None:
        at, lead = self._start_ns + t_ns, self._lead_ns
        if at - lead > time.monotonic_ns():
            self._spec.tv_sec, self._spec.tv_nsec = divmod(at - lead, 1_000_000_000)
            if self._sleep(time.CLOCK_MONOTONIC, TIMER_ABSTIME, ctypes.byref(self._spec), None):
                return  # a signal arrived
            late = time.monotonic_ns() > at
            self._lead_ns = min(lead + 9 * self.STEP_NS, self.LONGEST_LEAD_NS) if late else max(lead - self.STEP_NS, 0)
        while time.monotonic_ns() < at:
            pass

    def now(self) -> int:
        return time.monotonic_ns() - self._start_ns


def monotonic_ns() -> int:
    """Return ``CLOCK_MONOTONIC``, ns: for choosing a start, and for a parent's time-outs."""
    return time.monotonic_ns()


def pause(seconds: float) -> None:
    """Sleep in a process that keeps no time of its own (a parent that watches its children)."""
    time.sleep(seconds)


def wall_clock() -> str:
    """Return the date and time in UTC, ISO 8601: provenance of real-time runs only."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


def wall_clock_ns(monotonic: int) -> int:
    """Return what the clock on the wall says, ns since 1970, at an instant of ``CLOCK_MONOTONIC``: provenance likewise."""
    return time.time_ns() + monotonic - time.monotonic_ns()


class Kernel:
    """Begins the slots of a session, each with its *nominal* time.

    Args:
        clock: is waited on for each; None: virtual time, which jumps to whatever comes next.

    Attributes:
        stopped: whether :meth:`stop` was called.

    >>> kernel, seen = Kernel(), []
    >>> kernel.run(10, 3, seen.append); seen
    [0, 10, 20]
    """

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock
        self.stopped = False

    def stop(self) -> None:
        """Begin no further slot (safe in a signal handler)."""
        self.stopped = True

    def run(self, period_ns: int, slots: int, handler: Callable[[int], None]) -> None:
        """Call ``handler(t_ns)`` at 0, ``period_ns``, ... : ``slots`` times, or until :meth:`stop`."""
        for t_ns in range(0, slots * period_ns, period_ns):
            if not self.stopped and self._clock is not None:
                self._clock.wait_until(t_ns)
            if self.stopped:
                return
            handler(t_ns)
