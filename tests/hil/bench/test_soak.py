"""The soak measures growth where there is growth, and a session as it was."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hil.bench.soak import _memory, _predicted, bench_soak, judge, slope


def test_the_interval_covers_the_slope_as_often_as_it_says() -> None:
    """Binomial(400, 0.95): fewer than 365 or more than 394 with probability below 0.005, where the interval is right."""
    rng, t = np.random.default_rng(0), np.linspace(0.0, 10.0, 400)
    covered = 0
    for _ in range(400):
        estimate, half = slope(t, 2.0 * t + rng.normal(size=400))
        covered += abs(estimate - 2.0) <= half
    assert 365 <= covered <= 394


def test_a_leak_is_distinguished_from_steps_that_end() -> None:
    rng, t = np.random.default_rng(1), np.linspace(0.0, 600.0, 400)
    noise = rng.normal(scale=20.0, size=400)
    leak, half = slope(t, 80_000 + 0.5 * t + noise)
    assert leak - half > 0
    flat, half = slope(t, 80_000 + noise)
    assert flat - half <= 0 <= flat + half


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="19 samples, expected 20 at least"):
        slope(np.arange(19.0), np.arange(19.0))


@pytest.mark.slow
@pytest.mark.realtime
def test_a_short_soak_measures_every_process_the_log_and_the_sessions() -> None:
    row = bench_soak(duration_s=5.0, sessions=1, at_once=2)
    assert row["slots"] == 5000 or row["status"] != 0
    assert row["dropped"] == 0 and 0.5 < row["log_ratio"] < 2.0
    assert [each["process"] for each in row["memory"]] == ["session", "rig", "controller"]
    assert all(10 < each["mb"] < 1000 and each["plus_minus"] >= 0 for each in row["memory"])
    assert sum(row["in_a_row"].values()) == 1 and sum(row["at_once"].values()) == 2
    assert bool(row["why"]) == (row["verdict"] != "holds")
    assert not {"1", "2"} & {*row["in_a_row"], *row["at_once"]}  # each ran to its end, whatever the machine made of its timing


def test_memory_that_stays_exactly_the_same_has_no_slope() -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(1.0, 2.0, 293))
    for kb in (235_180.0, 201_080.0, 83_333.0):
        assert slope(t, np.full(293, kb)) == (0.0, 0.0)


QUIET = {
    "status": 0, "safety": None, "slots": 1000, "slots_expected": 1000, "dropped": 0, "log_ratio": 1.0, "timing_why": [],
    "memory": [{"process": "rig", "grows": False}], "cyclictest_us": {"p99": 20.0}, "cyclictest_missed_share": 0.0,
}  # fmt: skip
STOPPED = {"status": 3, "safety": "watchdog", "slots": 700, "timing_why": ["9 of 700 slots had no answer in time"]}
BUSY = {"cyclictest_us": {"p99": 400.0}, "cyclictest_missed_share": 0.02}
GROWS = {"memory": [{"process": "rig", "grows": True}]}


@pytest.mark.parametrize(
    ("change", "verdict", "reported"),
    [
        ({}, "holds", []),
        (BUSY, "holds", []),  # it kept its times all the same
        (STOPPED, "does not hold", ["stopped by safety after 700 of 1000 slots: watchdog", "no answer in time"]),
        (STOPPED | BUSY, "undecided", ["too busy to decide: p99 of cyclictest's lateness was 400 us", "stopped by safety"]),
        (STOPPED | {"cyclictest_missed_share": 0.02}, "undecided", ["missed 2.00%"]),
        (STOPPED | {"cyclictest_us": None, "cyclictest_missed_share": None}, "undecided", ["no cyclictest stood beside it"]),
        (BUSY | STOPPED | GROWS, "does not hold", ["rig: memory grows", "stopped by safety"]),
        (BUSY | {"dropped": 3}, "does not hold", ["3 records of the log were dropped"]),
        (BUSY | {"log_ratio": 1.2}, "does not hold", ["1.200 of its predicted length"]),
        (BUSY | {"status": 1, "slots": 10}, "does not hold", ["ended with status 1 after 10 of 1000 slots"]),
    ],
)  # fmt: skip
def test_a_busy_machine_is_no_fault_of_the_rig(change: dict[str, Any], verdict: str, reported: list[str]) -> None:
    found, why = judge(QUIET | change, {}, period_us=1000.0)
    assert found == verdict and bool(why) == (verdict != "holds")
    assert all(part in "; ".join(why) for part in reported)


def test_short_sessions_are_judged_too() -> None:
    def judged(row: dict[str, Any], statuses: dict[str, int], dropped: int = 0) -> tuple[str, list[str]]:
        return judge(row, {"at once": {"statuses": statuses, "dropped": dropped}}, period_us=1000.0)

    assert judged(QUIET, {"0": 8}) == ("holds", [])
    assert judged(QUIET, {"0": 6, "3": 2}) == ("does not hold", ["at once: 2 stopped by safety"])
    assert judged(QUIET | BUSY, {"0": 6, "3": 2})[0] == "undecided"
    assert judged(QUIET | BUSY, {"0": 7, "1": 1}) == ("does not hold", ["at once: 1 ended with status 1"])
    assert judged(QUIET, {"0": 8}, 5) == ("does not hold", ["at once: 5 records were dropped"])


@pytest.mark.parametrize(("leaks_per_s", "kind", "grows"), [(20, 48, True), (1000, 16, True), (20, 4, False), (0, 0, False)])
def test_an_object_that_leaks_per_chunk_or_slot_is_growth_and_some_pages_of_a_heap_are_not(
    leaks_per_s: int, kind: int, grows: bool
) -> None:
    """Ten minutes of a session of 57 MB that takes four pages at a time, and a page and a half of noise."""
    t = np.arange(0.0, 600.0, 1.5)
    noise = np.random.default_rng(0).normal(scale=6.0, size=t.size)
    leaked = np.floor(leaks_per_s * kind * t / 1024 / 16) * 16
    pages = 24.0 * (t > 480.0)
    assert _memory("session", t, 57_000.0 + leaked + noise + pages)["grows"] is grows


def test_the_size_of_a_log_is_predicted_by_its_growth_in_the_second_tenth() -> None:
    t = np.arange(101.0)
    log = np.where(t <= 10.0, 3.0 * t, np.where(t <= 20.0, 30.0 + 7.0 * (t - 10.0), 1e6))
    assert _predicted(t, log, 100.0) == pytest.approx(30.0 + 7.0 * 90.0)
    few = t <= 15.0  # of a session that ended early
    assert _predicted(t[few], log[few], 100.0) == pytest.approx(30.0 + 7.0 * 90.0)
