"""The clock at a pace, on a time that passes where it sleeps and nowhere else."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hil.runtime.time import clock as module
from hil.runtime.time.clock import PacedClock

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
def time(monkeypatch: pytest.MonkeyPatch) -> Time:
    fake = Time()
    monkeypatch.setattr(module, "time", fake)
    return fake


def test_session_time_passes_at_its_speed(time: Time) -> None:
    clock, begin = PacedClock(speed=4.0), time.now_ns
    assert (clock.speed, clock.held) == (4.0, False)
    for t_ns in (S // 2, 3 * S, 3 * S, 2 * S):
        clock.wait_until(t_ns)
    assert clock.now() == 3 * S and time.now_ns - begin == 3 * S // 4
    assert time.longest_s <= PacedClock.LOOK_S, "a change takes effect that soon"


def test_a_new_speed_counts_from_where_the_clock_is(time: Time) -> None:
    clock = PacedClock()
    clock.wait_until(2 * S)
    clock.set(speed=10.0)
    begin = time.now_ns
    clock.wait_until(12 * S)
    assert clock.speed == 10.0 and time.now_ns - begin == S


def test_what_cannot_keep_its_pace_does_not_hurry_afterwards_and_what_is_a_little_behind_catches_up(time: Time) -> None:
    clock = PacedClock()
    time.now_ns += PacedClock.BEHIND_NS // 2
    begin = time.now_ns
    clock.wait_until(S)
    assert time.now_ns - begin == S - PacedClock.BEHIND_NS // 2
    time.now_ns += 9 * S
    begin = time.now_ns
    for t_ns in (2 * S, 3 * S):
        clock.wait_until(t_ns)
    assert time.now_ns - begin == S, "the slot that is late goes at once, the next one at its pace"


def test_a_held_clock_lets_only_steps_pass_and_goes_on_from_there(time: Time) -> None:
    clock = PacedClock(held=True)
    begin = time.now_ns
    time.planned[begin + 5 * S] = lambda: clock.step(2)
    for t_ns in (S, 2 * S):
        clock.wait_until(t_ns)
    assert clock.held and clock.now() == 2 * S and 5.0 <= (time.now_ns - begin) / S <= 5.0 + PacedClock.LOOK_S
    begin = time.now_ns
    time.planned[begin + 3 * S] = lambda: clock.set(held=False)
    clock.wait_until(4 * S)
    assert not clock.held and 5.0 <= (time.now_ns - begin) / S <= 5.0 + PacedClock.LOOK_S


def test_a_step_holds_and_what_is_left_of_steps_is_forgotten_when_it_goes_on(time: Time) -> None:
    clock = PacedClock()
    clock.step(3)
    clock.wait_until(S)
    clock.set(held=True)
    begin = time.now_ns
    time.planned[begin + S] = clock.end
    clock.wait_until(2 * S)
    assert 1.0 <= (time.now_ns - begin) / S <= 1.0 + PacedClock.LOOK_S, "no step was left"


def test_an_ended_clock_waits_no_more(time: Time) -> None:
    for clock in (PacedClock(held=True), PacedClock(speed=1e-6)):
        begin = time.now_ns
        time.planned[begin + S] = clock.end
        for t_ns in (S, 2 * S):
            clock.wait_until(t_ns)
        assert clock.now() == 2 * S and 1.0 <= (time.now_ns - begin) / S <= 1.0 + PacedClock.LOOK_S
