"""When slots begin, and what the clocks promise."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from typing import Any

import pytest

from hil.runtime.clock import Kernel, PacedClock, RealClock


def test_stop_ends_the_run_within_its_event() -> None:
    kernel, seen = Kernel(), []

    def handler(t_ns: int) -> None:
        seen.append(t_ns)
        if t_ns == 20:
            kernel.stop()

    kernel.run(10, 100, handler)
    kernel.run(10, 100, handler)
    assert seen == [0, 10, 20] and kernel.stopped


def test_a_stop_while_the_clock_waits_lets_no_slot_begin() -> None:
    clock, seen = PacedClock(), []
    kernel = Kernel(clock)
    clock.wait_until = lambda t_ns: kernel.stop() if t_ns == 20 else None  # type: ignore[method-assign]
    kernel.run(10, 100, seen.append)
    assert seen == [0, 10]


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

    def drive(self, clock: RealClock, waits: int, ahead_ns: int = 200_000) -> None:
        """Wait for an instant so far ahead, so many times; note by how much the timer was set ahead."""
        clock._sleep = self._sleep  # type: ignore[assignment]
        for _ in range(waits):
            self.at = self.now_ns + ahead_ns
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
    monkeypatch.setattr("hil.runtime.clock.time", timer)
    timer.drive(RealClock(0), 200)
    assert timer.leads[0] == 0 and max(timer.leads) <= RealClock.LONGEST_LEAD_NS
    assert all(abs(lead - lead_ns) <= 10 * RealClock.STEP_NS for lead in timer.leads[100:])


def test_a_timer_that_comes_early_is_set_ahead_ever_less(monkeypatch: pytest.MonkeyPatch) -> None:
    timer, clock = Timer(-150_000), RealClock(0)
    monkeypatch.setattr("hil.runtime.clock.time", timer)
    clock._lead_ns = 5_000
    timer.drive(clock, 80)
    assert timer.leads == [max(5_000 - 100 * k, 0) for k in range(80)]


def test_what_is_nearer_than_the_lead_is_waited_for_without_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    timer, clock = Timer(0), RealClock(0)
    monkeypatch.setattr("hil.runtime.clock.time", timer)
    clock._lead_ns = 20_000
    timer.drive(clock, 5, ahead_ns=15_000)
    assert timer.leads == [] and clock._lead_ns == 20_000, "a timer that was not set says nothing of how late it comes"


def test_a_signal_ends_the_wait_however_long_it_would_be() -> None:
    clock = RealClock(time.monotonic_ns())
    clock._sleep = lambda *_: errno.EINTR  # type: ignore[assignment]
    clock.wait_until(10_000_000_000)
    assert clock.now() < 10_000_000_000


S = 1_000_000_000


class Time:
    """Time of the machine, ns; what is planned for an instant is done when a sleep passes it, as by another thread."""

    def __init__(self) -> None:
        self.now_ns, self.longest_s, self.planned = 77 * S, 0.0, dict[int, Callable[[], object]]()

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0.0
        self.longest_s = max(self.longest_s, duration_s)
        self.now_ns += round(duration_s * S)
        for at in sorted(at for at in self.planned if at <= self.now_ns):
            self.planned.pop(at)()


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Time:
    fake = Time()
    monkeypatch.setattr("hil.runtime.clock.time", fake)
    return fake


def test_session_time_passes_at_its_speed(machine: Time) -> None:
    clock, begin = PacedClock(speed=4.0), machine.now_ns
    assert (clock.speed, clock.paused) == (4.0, False)
    for t_ns in (S // 2, 3 * S, 3 * S, 2 * S):
        clock.wait_until(t_ns)
    assert clock.now_ns == 3 * S and machine.now_ns - begin == 3 * S // 4
    assert machine.longest_s <= PacedClock.LOOK_S, "a change takes effect that soon"


def test_a_new_speed_counts_from_where_the_clock_is(machine: Time) -> None:
    clock = PacedClock()
    clock.wait_until(2 * S)
    clock.set(speed=10.0)
    begin = machine.now_ns
    clock.wait_until(12 * S)
    assert clock.speed == 10.0 and machine.now_ns - begin == S


def test_what_cannot_keep_its_pace_does_not_hurry_afterwards_and_what_is_a_little_behind_catches_up(machine: Time) -> None:
    clock = PacedClock()
    machine.now_ns += PacedClock.BEHIND_NS // 2
    begin = machine.now_ns
    clock.wait_until(S)
    assert machine.now_ns - begin == S - PacedClock.BEHIND_NS // 2
    machine.now_ns += 9 * S
    begin = machine.now_ns
    for t_ns in (2 * S, 3 * S):
        clock.wait_until(t_ns)
    assert machine.now_ns - begin == S, "the slot that is late goes at once, the next one at its pace"


def test_a_held_clock_lets_only_steps_pass_and_goes_on_from_there(machine: Time) -> None:
    clock = PacedClock(paused=True)
    begin = machine.now_ns
    machine.planned[begin + 5 * S] = lambda: clock.step(2)
    for t_ns in (S, 2 * S):
        clock.wait_until(t_ns)
    assert clock.paused and clock.now_ns == 2 * S and 5.0 <= (machine.now_ns - begin) / S <= 5.0 + PacedClock.LOOK_S
    begin = machine.now_ns
    machine.planned[begin + 3 * S] = lambda: clock.set(paused=False)
    clock.wait_until(4 * S)
    assert not clock.paused and 5.0 <= (machine.now_ns - begin) / S <= 5.0 + PacedClock.LOOK_S


def test_a_step_holds_and_what_is_left_of_steps_is_forgotten_when_it_goes_on(machine: Time) -> None:
    clock = PacedClock()
    clock.step(3)
    clock.wait_until(S)
    clock.set(paused=True)
    begin = machine.now_ns
    machine.planned[begin + S] = clock.end
    clock.wait_until(2 * S)
    assert 1.0 <= (machine.now_ns - begin) / S <= 1.0 + PacedClock.LOOK_S, "no step was left"


def test_an_ended_clock_waits_no_more(machine: Time) -> None:
    for clock in (PacedClock(paused=True), PacedClock(speed=1e-6)):
        begin = machine.now_ns
        machine.planned[begin + S] = clock.end
        for t_ns in (S, 2 * S):
            clock.wait_until(t_ns)
        assert clock.now_ns == 2 * S and 1.0 <= (machine.now_ns - begin) / S <= 1.0 + PacedClock.LOOK_S
