"""The rig beside cyclictest: that both are measured, and that both are judged over every slot."""

from __future__ import annotations

import json
import os
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from hil.bench.timing import Turn, _row, bench_live, bench_timing, read_cyclictest, read_page
from hil.errors import HilError


def test_slots_that_cyclictest_left_out_count_with_the_lateness_they_would_have_had(tmp_path: Path) -> None:
    output = tmp_path / "cyclictest.json"
    # A stall of 2.5 ms at 1 kHz: two slots have gone by, 1.5 and 0.5 ms late.
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


@pytest.mark.realtime
def test_readers_of_the_live_page_are_counted_beside_a_session_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.bench.timing.READERS", (0, 1))
    said: list[str] = []
    link = f"can:hil:live{os.getpid()}"
    rows = bench_live(duration_s=0.8, turns=1, link=link, experiment="dc-motor-1khz", progress=said.append)
    assert said == [f"turn 1 of 1: dc-motor-1khz over {link}, {n} readers" for n in (0, 1)]
    assert [(row["readers"], row["slots"], row["dropped_records"]) for row in rows] == [(0, 800, 0), (1, 800, 0)]
    assert rows[0]["pictures"] == 0 and all(row["pictures"] >= 0 and 0 <= row["missed"] <= 1600 for row in rows)
    for row in rows:
        for q in ("p50", "max"):
            assert row["ratio"][q] == pytest.approx(row["lateness_us"][q] / max(rows[0]["lateness_us"][q], 1.0))


def test_a_reader_asks_as_the_page_does_until_the_server_ends() -> None:
    """Every eighth time for words too; what no server answers are no pictures."""

    class Server(BaseHTTPRequestHandler):
        asked: ClassVar[list[str]] = []

        def do_GET(self) -> None:
            self.asked.append(self.path)
            if len(self.asked) > 17:
                self.connection.close()
                return
            self.send_response(200)
            self.send_header("Content-Length", "2")
            self.end_headers()
            self.wfile.write(b"{}")

        def log_message(self, format: str, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Server) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        assert read_page(f"127.0.0.1:{server.server_port}") == 17
        server.shutdown()
        thread.join()
    assert [n for n, path in enumerate(Server.asked) if path.endswith("&words=1")] == [0, 8, 16]
    assert {path.removesuffix("&words=1") for path in Server.asked} == {"/view?columns=1000"}
    assert read_page(f"127.0.0.1:{server.server_port}") == 0


def turn(lateness_us: list[float], beside_us: list[float], missed: int, dropped: int) -> Turn:
    slots = np.zeros(len(lateness_us), [("lateness_us", "<f8"), ("round_trip_us", "<f8"), ("late", "?"), ("overrun", "?")])
    slots["lateness_us"], slots["round_trip_us"] = lateness_us, 100.0
    slots["late"][0] = slots["overrun"][:2] = True
    return Turn(1e-3, slots, np.array(beside_us), missed, {"log": {"dropped": dropped}, "timing": {"scheduler": "fifo"}})


def test_a_row_is_of_all_turns_together_and_compares_with_cyclictest_of_the_same_time() -> None:
    row = _row("mine", "can:hil:x", "free", [turn([40.0] * 10, [20.0] * 10, 1, 2), turn([80.0] * 30, [20.0] * 30, 3, 4)])
    assert (row["slots"], row["turns"], row["dropped_records"], row["late"], row["overruns"]) == (40, 2, 6, 2, 4)
    assert (row["late_share"], row["overrun_share"], row["cyclictest_missed_share"]) == (0.05, 0.1, 0.1)
    assert row["ratio"]["p50"] == 4.0 and row["lateness_us"]["max"] == 80.0 and row["round_trip_us"]["p50"] == 100.0
    at_once = _row("mine", "can:hil:x", "free", [turn([40.0] * 10, [0.0] * 10, 0, 0)])
    assert at_once["ratio"]["p50"] == 40.0, "cyclictest counts whole microseconds: less than one is one"
