"""The rig beside cyclictest: that both are measured, and that both are judged over every tick."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from hil.bench.timing import bench_timing, read_cyclictest
from hil.errors import HilError


def test_ticks_that_cyclictest_left_out_count_with_the_lateness_they_would_have_had(tmp_path: Path) -> None:
    output = tmp_path / "cyclictest.json"
    # A stall of 2.5 ms at 1 kHz: two ticks have gone by, 1.5 and 0.5 ms late.
    output.write_text(json.dumps({"thread": {"0": {"histogram": {"20": 6, "2500": 1}}}}))
    late_us, missed = read_cyclictest(output, 1000)
    assert sorted(late_us) == [20] * 6 + [500, 1500, 2500]
    assert missed == 2


@pytest.mark.parametrize("change", ["period=0.002", "duration = 3"])
def test_what_the_bench_fixes_is_not_set(change: str) -> None:
    with pytest.raises(HilError, match="this bench runs at the rate of the experiment, for as long as --duration says"):
        bench_timing(sets=["timing.affinity=pinned", change])


@pytest.mark.cyclictest
@pytest.mark.realtime
def test_rig_and_cyclictest_are_measured_in_one_run() -> None:
    (row,) = bench_timing(duration_s=1.2, turns=2, links=[f"can:hil:bench{os.getpid()}"])
    for of in ("lateness_us", "cyclictest_us"):
        assert 0 < row[of]["p50"] <= row[of]["max"]
    assert row["ratio"]["p50"] == row["lateness_us"]["p50"] / max(row["cyclictest_us"]["p50"], 1.0)
    assert row["round_trip_ratio"] == 1.0  # the last link is what the others are compared with
    assert row["slots"] == 1200 and row["dropped_records"] == 0
    assert 0 <= row["cyclictest_missed_share"] < 1


@pytest.mark.cyclictest
@pytest.mark.realtime
def test_two_experiments_are_measured_in_turns() -> None:
    rows = bench_timing(
        duration_s=0.6, turns=1, links=[f"can:hil:two{os.getpid()}"], experiments=["dc-motor-1khz", "omni-1khz"],
        sets=["report.measures=[]"],
    )  # fmt: skip
    assert [row["experiment"] for row in rows] == ["dc-motor-1khz", "omni-1khz"]
    assert all(row["slots"] == 600 and row["dropped_records"] == 0 and row["period_s"] == 1e-3 for row in rows)
    assert rows[-1]["round_trip_ratio"] == 1.0
