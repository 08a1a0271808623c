"""`hil bench links --can` measures what it says; no test of how fast anything is."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator

import pytest

from hil.bench.can_buses import FLOOD, _row, bench_can_buses


@pytest.fixture(autouse=True)
def bus_directory(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory(prefix="hil-test-") as path:
        monkeypatch.setenv("HIL_CAN_DIR", path)
        yield


@pytest.mark.realtime
def test_every_bus_has_a_row_and_frames_in_time_have_an_error_beside_cyclictest() -> None:
    off, on, virtual, none = bench_can_buses(0.1, buses=("hil", "hil, 1 Mbit/s in time", "virtual", "nosuch"))
    for row in (off, on, virtual):
        assert row["note"] == "" and row["lost"] == 0 and row["frames_s"] > 0 and 0 < row["p50_us"] <= row["p99_us"]
        assert row["times_off"] == pytest.approx(row["frames_s"] / off["frames_s"])
        assert row["trip_times_off"] == pytest.approx(row["p50_us"] / off["p50_us"])
    assert on["frames_s"] < 1e6 / 112  # bits of its frames
    assert off["late_p99_us"] is None and on["late_p99_us"] >= on["late_p50_us"] > -1000  # two clocks, read one after the other
    if shutil.which("cyclictest"):
        assert on["late_of_cyclictest"] == pytest.approx(on["late_p99_us"] / on["cyclictest_p99_us"])
    assert "nosuch" in none["note"] and math.isnan(none["frames_s"])


def test_a_row_counts_what_came_and_what_was_lost() -> None:
    """Two floods in 2 s, of which 30 frames did not come; four round trips of 1 to 3 us and one without an answer."""
    floods = [(FLOOD - 10, 500_000_000), (FLOOD - 20, 1_500_000_000)]
    row = _row("mine", floods, [1000, 2000, 2000, 3000, -1], [4000, 8000], 2.0, "a note")
    assert row["frames_s"] == (2 * FLOOD - 30) / 2.0 and row["lost"] == 31 and row["note"] == "a note"
    assert row["p50_us"] == 2.0 and 2.9 < row["p99_us"] < 3.0
    assert row["late_p50_us"] == 6.0 and row["late_of_cyclictest"] == pytest.approx(row["late_p99_us"] / 2.0)
    assert row["cyclictest_p99_us"] == 2.0 and math.isnan(row["times_off"])
    alone = _row("mine", floods, [1000], [4000], math.nan, "")
    assert alone["cyclictest_p99_us"] is None and alone["late_of_cyclictest"] is None and alone["late_p99_us"] == 4.0
    none = _row("none", [], [], [], 2.0, "no such bus")
    assert none["lost"] == 0 and math.isnan(none["frames_s"]) and math.isnan(none["p50_us"]) and none["late_p50_us"] is None
    assert none["cyclictest_p99_us"] is None
