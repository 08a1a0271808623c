"""`hil bench links --can` measures what it says; no test of how fast anything is."""

from __future__ import annotations

import io
import math
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from hil.bench import can_buses
from hil.bench.can_buses import _ANSWER, FLOOD, _echo, _flood, _join, _row, _trips, bench_can_buses, main
from transport.links.python_can import can


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


def test_a_pair_counts_frames_and_times_round_trips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over python-can's bus within one process; an error frame is no answer, and without another end nothing comes."""
    monkeypatch.setattr(can_buses, "_PATIENCE_S", 600.0)
    over, name = threading.Event(), f"pair-{os.getpid()}"
    with _join("virtual", name) as ours, _join("virtual", name) as other:
        received = other.recv
        monkeypatch.setattr(other, "recv", lambda timeout: sys.exit() if over.is_set() else received(0.02))

        def answer() -> None:
            with suppress(SystemExit):
                _echo(other)

        thread = threading.Thread(target=answer)
        thread.start()
        other.send(can.Message(arbitration_id=_ANSWER, is_error_frame=True))
        trips = _trips(ours, 3, timed=False)
        found, ns = _flood(ours, 30)
        again, _ = _flood(ours, 5)
        timed = _trips(ours, 2, timed=True)
        over.set()
        thread.join()
        assert len(trips) == 3 and all(0 < each < 6e11 for each in trips)
        assert (found, again) == (30, 35) and 0 < ns < 6e11
        assert len(timed) == 4 and all(0 < each < 6e11 for each in timed[:2]) and all(abs(late) < 6e11 for late in timed[2:])
        monkeypatch.setattr(can_buses, "_PATIENCE_S", 0.01)
        assert _trips(ours, 2, timed=True) == [-1, -1]
        lost, ns = _flood(ours, 2)
        assert lost == 0 and ns >= 1e7


def test_each_bus_is_joined_as_its_name_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_buses.can, "Bus", dict)
    monkeypatch.setattr(os, "getppid", lambda: 23_456)
    hil: dict[str, Any] = {"interface": "hil", "channel": "c", "ignore_config": True}
    assert [_join(bus, "c") for bus in can_buses.BUSES] == [
        hil, hil | {"bitrate": 1_000_000}, hil | {"bitrate": 1_000_000, "timed": True},
        hil | {"interface": "socketcan", "channel": "vcan0"},
        hil | {"interface": "udp_multicast", "channel": "239.74.163.2", "port": 23_456, "hop_limit": 0},
        hil | {"interface": "virtual"},
    ]  # fmt: skip


def test_a_driving_process_answers_each_line_and_one_without_a_bus_says_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    urgent: list[int] = []
    monkeypatch.setattr("hil.bench.die_with_parent", lambda pid: None)
    monkeypatch.setattr(can_buses, "go_real_time", lambda priority, cpu, *, awake: urgent.append(priority))
    monkeypatch.setattr("hil.bench.signal.signal", lambda *_: None)
    monkeypatch.setattr(can_buses, "_PATIENCE_S", 0.01)
    monkeypatch.setattr(sys, "argv", ["", "drive", "hil", f"drive-{os.getpid()}"])
    monkeypatch.setattr(sys, "stdin", io.StringIO("trips 2\nflood 1\n"))
    main()
    ready, trips, flood = capsys.readouterr().out.splitlines()
    assert (ready, trips, flood.split()[0]) == ("ready", "-1 -1", "0")
    answering: list[can.BusABC] = []
    monkeypatch.setattr(can_buses, "_echo", answering.append)
    monkeypatch.setattr(sys, "argv", ["", "drive", "virtual", f"drive-{os.getpid()}"])
    monkeypatch.setattr(sys, "stdin", io.StringIO("trips 1\n"))
    main()
    assert capsys.readouterr().out == "ready\n-1\n" and len(answering) == 1, "the other end is a thread, as all is one process"
    monkeypatch.setattr(sys, "argv", ["", "echo", "nosuch", "x"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1 and "nosuch" in capsys.readouterr().out
    assert urgent == [60, 60, 59]
