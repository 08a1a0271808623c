"""Order of events, and what the two clocks promise."""

from __future__ import annotations

import time

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
