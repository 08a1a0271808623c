"""The rig beside cyclictest: that both are measured, and what is compared with what."""

from __future__ import annotations

import os

import numpy as np
import pytest

from hil.bench.timing import bench_timing, wake_ups_us
from hil.log.read import Run


def test_slots_that_run_back_to_back_after_a_stall_are_no_wake_ups() -> None:
    kind = np.dtype([("lateness_us", "f8"), ("round_trip_us", "f8"), ("work_us", "f8")])
    # A stall of 2.5 ms before slot 2 of a 1 ms loop: slots 3 and 4 follow at once.
    late = [20.0, 25.0, 2500.0, 1600.0, 700.0, 30.0]
    ticks = np.array([(us, 60.0, 40.0) for us in late], dtype=kind)
    run = Run(arrays={"/timing/tick": ticks}, schemas={}, resolved={"period": 0.001})
    assert wake_ups_us(run).tolist() == [20.0, 25.0, 2500.0, 30.0]


@pytest.mark.cyclictest
@pytest.mark.realtime
def test_rig_and_cyclictest_are_measured_in_one_run() -> None:
    (row,) = bench_timing(duration_s=1.5, links=[f"can:hil:bench{os.getpid()}"])
    for of in ("lateness_us", "wake_up_us", "cyclictest_us"):
        assert 0 < row[of]["p50"] <= row[of]["max"]
    assert row["ratio"]["p50"] == row["wake_up_us"]["p50"] / max(row["cyclictest_us"]["p50"], 1.0)
    assert row["ticks"] > 100 and row["dropped_records"] == 0
