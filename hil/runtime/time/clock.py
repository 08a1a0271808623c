"""Two clocks, one meaning: session time in nanoseconds. No other file reads a clock or sleeps."""

from __future__ import annotations

import ctypes
import time
from typing import Protocol

TIMER_ABSTIME = 1


class Clock(Protocol):
    """Where an event kernel gets its time from."""

    def wait_until(self, t_ns: int) -> None:
        """Return when session time is at least ``t_ns`` (or a signal arrived)."""
        ...

    def now(self) -> int:
        """Return session time, ns."""
        ...


class VirtualClock:
    """Jumps to whatever instant is waited for.

    >>> c = VirtualClock(); c.wait_until(5); c.now()
    5
    """

    def __init__(self) -> None:
        self._now = 0

    def wait_until(self, t_ns: int) -> None:
        if t_ns > self._now:
            self._now = t_ns

    def now(self) -> int:
        return self._now


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


_libc = ctypes.CDLL(None, use_errno=True)


class RealClock:
    """Waits on absolute ``CLOCK_MONOTONIC`` deadlines; session time 0 is ``start_ns`` on that clock.

    Args:
        start_ns: ``CLOCK_MONOTONIC`` instant of session time 0, ns.
    """

    def __init__(self, start_ns: int) -> None:
        self.begin(start_ns)
        self._sleep = _libc.clock_nanosleep
        self._spec = _Timespec()

    def begin(self, start_ns: int) -> None:
        """Let session time be 0 at another instant."""
        self._start_ns = start_ns

    def wait_until(self, t_ns: int) -> None:
        at = self._start_ns + t_ns
        if at > time.monotonic_ns():
            self._spec.tv_sec, self._spec.tv_nsec = divmod(at, 1_000_000_000)
            self._sleep(time.CLOCK_MONOTONIC, TIMER_ABSTIME, ctypes.byref(self._spec), None)

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
