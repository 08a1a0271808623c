"""The rig beside cyclictest: that both are measured, and that both are judged over every slot."""

from __future__ import annotations

import json
import os
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from hil.bench import timing
from hil.bench.timing import Turn, _row, bench_live, bench_timing, read_cyclictest, read_page, start_cyclictest, take_turn
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


def test_experiments_links_and_affinities_take_turns_and_are_compared_with_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    said: list[str] = []

    def taken(name: str, uri: str, duration_s: float, folder: Path, sets: list[str]) -> Turn:
        asked.append((name, uri, duration_s, sets))
        found = turn([40.0] * 10, [20.0] * 10, 0, 0)
        found.timed["round_trip_us"] *= 3.0 if uri == "a" else 1.0
        return found

    monkeypatch.setattr(timing, "take_turn", taken)
    sets, both = ["report.measures=[]"], ["dc-motor-1khz", "omni-1khz"]
    rows = bench_timing(
        duration_s=4.0, turns=2, links=["a", "b"], experiments=both, sets=sets, affinities=["free", "shared"],
        progress=said.append,
    )  # fmt: skip
    ways = [(name, uri, how) for name in both for uri in "ab" for how in ("free", "shared")]
    assert asked == [(name, uri, 2.0, [*sets, f"timing.affinity={how}"]) for name, uri, how in ways] * 2
    each = [f"{name} at 1000 Hz for 2 s over {uri} ({how}), cyclictest beside it" for name, uri, how in ways]
    assert said == [f"turn {n} of 2: {one}" for n in (1, 2) for one in each]
    assert [(row["experiment"], row["link"], row["affinity"]) for row in rows] == ways and {row["turns"] for row in rows} == {2}
    assert [row["round_trip_ratio"] for row in rows] == [3.0, 3.0, 1.0, 1.0] * 2


def test_a_turn_is_of_what_its_session_and_cyclictest_wrote(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the place of both: programs, and what those would have written."""
    slots, histogram = np.zeros(3, [("lateness_us", "<f8")]), {"thread": {"0": {"histogram": {"20": 6, "2500": 1}}}}
    status, text, command = 0, json.dumps(histogram), ["true"]
    started: list[subprocess.Popen[bytes]] = []

    def ran(experiment: Any, *, clock: str, link: str, path: Path, onlooker: None) -> Any:
        assert (clock, link, experiment.duration) == ("real", "x:", 2.5) and experiment.timing.affinity == "shared"
        path.write_bytes(b"")
        summary = {"problems": {"rig": "why", "more": "so"}}
        return SimpleNamespace(status=status, summary=summary, run=SimpleNamespace(arrays={"/timing/slot": slots}))

    def start(priority: int, period_us: int, duration_s: float, output: Path) -> subprocess.Popen[bytes]:
        assert (priority, period_us, duration_s) == (60, 1000, 2.5)
        if text:
            output.write_text(text)
        started.append(subprocess.Popen(command, stderr=subprocess.PIPE))
        return started[-1]

    def take(beside: bool = True) -> Turn:
        return take_turn("dc-motor-1khz", "x:", 2.5, tmp_path, ["timing.affinity=shared"], beside=beside)

    monkeypatch.setattr(timing, "run_session", ran)
    monkeypatch.setattr(timing, "start_cyclictest", start)
    found = take()
    assert (found.period_s, found.timed is slots, sorted(found.cyclictest_us), found.missed) == (
        1e-3, True, [20] * 6 + [500, 1500, 2500], 2,
    )  # fmt: skip
    alone = take(beside=False)
    assert (len(alone.cyclictest_us), alone.missed, len(started)) == (0, 0, 1) and not list(tmp_path.iterdir())
    command = ["sleep", "100"]
    for ended, error, said in ((130, SystemExit, "130"), (1, HilError, "x:: the session failed: why; so")):
        status = ended
        with pytest.raises(error, match=said):
            take()
        assert started[-1].poll() is not None
    status, text, command = 0, "", ["sh", "-c", "echo no room >&2"]
    (tmp_path / "cyclictest.json").unlink()
    with pytest.raises(HilError, match="cyclictest gave no result: 'no room"):
        take()


def test_cyclictest_runs_at_the_rate_and_the_priority_of_the_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program, output = tmp_path / "cyclictest", tmp_path / "out.json"
    program.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/asked\n')
    program.chmod(0o755)
    monkeypatch.setattr(timing.shutil, "which", lambda name: str(program) if name == "cyclictest" else None)
    for user, priority in ((0, " -p80"), (1000, "")):
        monkeypatch.setattr(timing.os, "geteuid", lambda user=user: user)
        assert start_cyclictest(80, 500, 2.6, output).wait() == 0
        assert (tmp_path / "asked").read_text() == f"-q -m -i500 -D3 -h100000 --json={output}{priority}\n"
    start_cyclictest(80, 500, 0.2, output).wait()
    assert " -D1 " in (tmp_path / "asked").read_text()
    monkeypatch.setattr(timing.shutil, "which", lambda name: None)
    with pytest.raises(HilError, match="apt-get install rt-tests"):
        start_cyclictest(80, 500, 1.0, output)


def test_rows_of_readers_are_of_all_turns_together(monkeypatch: pytest.MonkeyPatch) -> None:
    lengths: list[float] = []

    def session(readers: int, name: str, uri: str, duration_s: float, folder: Path) -> tuple[Turn, int]:
        lengths.append(duration_s)
        return turn([20.0 + 20.0 * readers] * 10, [], 0, 2 * readers), 7 * readers

    monkeypatch.setattr(timing, "_session", session)
    rows = bench_live(duration_s=4.0, turns=2, link="x:", experiment="mine")
    assert lengths == [2.0] * 6
    assert [tuple(row[key] for key in ("readers", "slots", "missed", "dropped_records", "pictures")) for row in rows] == [
        (0, 20, 6, 0, 0), (1, 20, 6, 4, 14), (3, 20, 6, 12, 42),
    ]  # fmt: skip
    assert [row["ratio"]["p50"] for row in rows] == [1.0, 2.0, 4.0] and rows[2]["lateness_us"]["max"] == 80.0
