"""Safety at the rig: limits, watchdog, latch."""

from __future__ import annotations

import math

import pytest

from hil.runtime.nodes.safety import Safety


@pytest.mark.parametrize("value", [2.1, -2.1, math.nan, math.inf, -math.inf])
def test_state_beyond_its_bound_or_not_finite_trips(value: float) -> None:
    safety = Safety(None, [(1, "speed", 2.0)], 3)
    assert safety.check_state((0.0, 2.0)) is None
    assert "speed" in (safety.check_state((0.0, value)) or "")
    assert safety.tripped


def test_unlimited_state_that_is_not_finite_trips_too() -> None:
    assert Safety(None, [], 3).check_state((math.nan,)) == "the plant's state is not finite"


def test_command_beyond_its_bound_trips_once_and_stays_tripped() -> None:
    safety = Safety((1.0,), [], 3)
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
