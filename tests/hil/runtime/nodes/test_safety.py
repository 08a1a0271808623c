"""Safety at the rig: limits, watchdog, latch."""

from __future__ import annotations

import math

import pytest

from hil.runtime.nodes.safety import Safety
from plants import Signal


@pytest.mark.parametrize("value", [2.1, -2.1, math.nan, math.inf, -math.inf])
def test_state_beyond_its_bound_or_not_finite_trips(value: float) -> None:
    safety = Safety(None, [(1, Signal("speed", "m/s"), 2.0)], 3)
    assert safety.check_state((0.0, 2.0)) is None
    assert safety.check_state((0.0, value)) == f"speed = {value:.4g} m/s is beyond its limit 2 m/s"
    assert safety.tripped


def test_unlimited_state_that_is_not_finite_trips_too() -> None:
    assert Safety(None, [], 3).check_state((math.nan,)) == "the plant's state is not finite"


def test_a_command_beyond_its_bound_is_told_by_the_name_and_unit_of_its_input() -> None:
    safety = Safety((1.0, 5.0), [], 3, 0, (Signal("flow", "1"), Signal("voltage", "V")))
    assert safety.check_command((0.5, -5.2)) == "command voltage = -5.2 V is beyond its limit 5 V"


def test_a_command_of_a_pure_number_has_no_unit() -> None:
    assert Safety((1.0,), [], 3, 0, (Signal("flow", "1"),)).check_command((1.5,)) == "command flow = 1.5 is beyond its limit 1"


def test_command_beyond_its_bound_trips_once_and_stays_tripped() -> None:
    safety = Safety((1.0,), [], 3, 0, (Signal("voltage", "V"),))
    assert safety.check_command((1.0,)) is None
    assert safety.check_command((1.01,)) is not None
    assert safety.check_command((0.0,)) is None  # said once
    assert safety.tripped is not None and "1.01" in safety.tripped


def test_watchdog_counts_slots_in_a_row_only() -> None:
    safety = Safety(None, [], 3)
    for _ in range(10):
        assert safety.starved() is None
        assert safety.starved() is None
        assert safety.check_command((0.0,)) is None
    assert [safety.starved() is not None for _ in range(4)] == [False, False, True, False]


def test_the_watchdog_trips_by_the_clock_where_slots_take_longer() -> None:
    """200 slots of 1 ms are 200 ms, also where a slot takes 4 ms; in nominal time nothing changes."""
    ms = 1_000_000
    slow, nominal = Safety(None, [], 200, ms), Safety(None, [], 200, ms)
    tripped = [k for k in range(200) if slow.starved(4 * k * ms)]
    assert tripped == [50] and "ms (51 slots) without a usable command" in str(slow.tripped)  # 199 ms after the first
    assert [k for k in range(300) if nominal.starved(k * ms)] == [199] and "200 slots in a row" in str(nominal.tripped)
    fed = Safety(None, [], 200, ms)
    assert not any(fed.starved(4 * k * ms) or (k % 40 == 0 and fed.check_command((0.0,))) for k in range(400))
