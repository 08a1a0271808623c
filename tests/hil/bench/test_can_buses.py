"""`hil bench links --can` measures what it says; no test of how fast anything is."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator

import pytest

from hil.bench.can_buses import bench_can_buses


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
