"""Order of events, and what the two clocks promise."""

from __future__ import annotations

import errno
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.runtime.time.clock import RealClock, VirtualClock
from hil.runtime.time.kernel import Kernel


@given(st.lists(st.integers(0, 5), max_size=40))
def test_events_run_by_time_then_order_of_scheduling(instants: list[int]) -> None:
    kernel, seen = Kernel(VirtualClock()), []
    for i, t_ns in enumerate(instants):
        kernel.at(t_ns, lambda t, i=i: seen.append((t, i)))  # type: ignore[misc]
    kernel.run()
    assert seen == sorted((t, i) for i, t in enumerate(instants))


def test_periodic_events_keep_their_order_at_every_instant() -> None:
    kernel, seen = Kernel(VirtualClock()), []
    for name in "abc":
        kernel.every(10, 3, lambda t, name=name: seen.append((t, name)))  # type: ignore[misc]
    kernel.run()
    assert seen == [(t, name) for t in (0, 10, 20) for name in "abc"]


def test_stop_ends_the_run_within_its_event() -> None:
    kernel, seen = Kernel(VirtualClock()), []

    def handler(t_ns: int) -> None:
        seen.append(t_ns)
        if t_ns == 20:
            kernel.stop()

    kernel.every(10, 100, handler)
    kernel.run()
    assert seen == [0, 10, 20]
    assert kernel.stopped


def test_real_clock_never_returns_early_and_a_past_instant_costs_no_wait() -> None:
    start = time.monotonic_ns()
    clock = RealClock(start)
    for t_ns in (3_000_000, 5_000_000, 1_000_000):
        clock.wait_until(t_ns)
        assert clock.now() >= t_ns
    RealClock(start - 10**17).wait_until(0)  # three years ago


class Timer:
    """A time of its own, in which a sleep ends so many ns after the instant asked for; before it where negative."""

    CLOCK_MONOTONIC = time.CLOCK_MONOTONIC

    def __init__(self, late_ns: int) -> None:
        self.late_ns, self.now_ns, self.leads = late_ns, 0, list[int]()

    def monotonic_ns(self) -> int:
        self.now_ns += 50
        return self.now_ns

    def drive(self, clock: RealClock, waits: int) -> None:
        """Wait for an instant 200 us ahead, so many times; note by how much the timer was set ahead."""
        clock._sleep = self._sleep  # type: ignore[assignment]
        for _ in range(waits):
            self.at = self.now_ns + 200_000
            clock.wait_until(self.at)
            assert self.now_ns >= self.at

    def _sleep(self, _clock: int, _flags: int, spec: Any, _left: None) -> int:
        until = spec._obj.tv_sec * 1_000_000_000 + spec._obj.tv_nsec
        self.leads.append(self.at - until)
        self.now_ns = max(self.now_ns, until + self.late_ns)
        return 0


@pytest.mark.parametrize(("late_ns", "lead_ns"), [(20_000, 20_000), (120_000, 50_000)])
def test_a_timer_that_comes_late_is_set_ahead_by_so_much_and_by_50_us_at_most(
    late_ns: int, lead_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    timer = Timer(late_ns)
    monkeypatch.setattr("hil.runtime.time.clock.time", timer)
    timer.drive(RealClock(0), 200)
    assert timer.leads[0] == 0 and max(timer.leads) <= RealClock.LONGEST_LEAD_NS
    assert all(abs(lead - lead_ns) <= 10 * RealClock.STEP_NS for lead in timer.leads[100:])


def test_a_timer_that_comes_early_is_set_ahead_ever_less(monkeypatch: pytest.MonkeyPatch) -> None:
    timer, clock = Timer(-150_000), RealClock(0)
    monkeypatch.setattr("hil.runtime.time.clock.time", timer)
    clock._lead_ns = 5_000
    timer.drive(clock, 80)
    assert timer.leads[0] == 5_000 and timer.leads[-1] == 0 == min(timer.leads)


def test_a_signal_ends_the_wait_however_long_it_would_be() -> None:
    clock = RealClock(time.monotonic_ns())
    clock._sleep = lambda *_: errno.EINTR  # type: ignore[assignment]
    clock.wait_until(10_000_000_000)
    assert clock.now() < 10_000_000_000
