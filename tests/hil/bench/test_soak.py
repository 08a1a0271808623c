"""The soak measures growth where there is growth, and a session as it was."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.bench import soak
from hil.bench.soak import (
    PROCESSES,
    Samples,
    _beside,
    _memory,
    _predicted,
    _processes,
    _resident_kb,
    _watch,
    bench_soak,
    judge,
    slope,
)
from hil.errors import HilError


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


@pytest.mark.realtime
def test_a_short_soak_measures_every_process_the_log_and_the_sessions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "SHORT_S", 0.2)
    said: list[str] = []
    row = bench_soak(duration_s=2.5, at_once=1, progress=said.append)
    assert said == ["1 kHz for 2.5 s over can:hil", "at once: 1 of 1, 1 sessions of 0.2 s"]
    assert row["slots_expected"] == 2500 and (row["slots"] == 2500 or row["status"] != 0)
    assert (row["safety"] is None) == (row["status"] != soak.SAFETY)
    assert row["dropped"] == 0 and row["log_ratio"] == pytest.approx(row["log_bytes"] / row["log_predicted"])
    assert row["log_bytes"] > 200 * row["slots"] and 0.2 < row["log_ratio"] < 5.0
    assert [each["process"] for each in row["memory"]] == ["session", "rig", "controller"]
    assert all(10 < each["mb"] < 1000 and each["plus_minus"] >= 0 for each in row["memory"])
    assert row["in_a_row"] is None and sum(row["at_once"].values()) == 1
    assert row["short_dropped"] == {"at once": 0} and 0.0 <= row["overrun_share"] <= 1.0
    assert not {"1", "2"} & {*row["at_once"]}  # each ran to its end, whatever the machine made of its timing
    beside = row["cyclictest_us"]
    assert (beside is None) == (row["cyclictest_missed_share"] is None) == (shutil.which("cyclictest") is None)
    for late in (row["lateness_us"], *([beside] if beside else [])):
        assert 0 < late["p50"] <= late["p99"] <= late["max"]
    assert bool(row["why"]) == (row["verdict"] != "holds")


def test_a_session_without_a_summary_or_of_few_samples_is_no_soak(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the place of a session: a program that ends at once."""
    for written, said in (("", "ended with status 7 and without a summary"), ("{}", r"only 0 samples .*\(status 7\)")):
        program = f"from pathlib import Path; Path('0.json').write_text('{written}'); raise SystemExit(7)"
        words = [sys.executable, "-c", program]
        monkeypatch.setattr(soak, "_start", lambda folder, *_, words=words: subprocess.Popen(words, cwd=folder))
        monkeypatch.setattr(soak.shutil, "which", lambda name: None)
        with pytest.raises(HilError, match=said):
            bench_soak(duration_s=1.0)


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


def test_memory_that_a_session_takes_while_it_fills_its_buffers_is_no_growth_and_what_it_takes_later_is() -> None:
    t = np.arange(0.0, 600.0, 1.5)
    noise = np.random.default_rng(0).normal(scale=6.0, size=t.size)
    filling = 57_000.0 + 5000.0 * np.minimum(t / 250.0, 1.0) + noise
    found = _memory("rig", t, filling)
    assert not found["grows"] and found["mb"] == pytest.approx(62.0, abs=0.1)
    later = _memory("rig", t, 57_000.0 + 1000.0 * np.maximum(t - 350.0, 0.0) / 250.0 + noise)
    assert later["grows"] and later["slope_kb_per_min"] == pytest.approx(60.0 * 1000.0 / 250.0, rel=0.1)


def test_the_size_of_a_log_is_predicted_by_its_growth_in_the_second_tenth() -> None:
    t = np.arange(101.0)
    log = np.where(t <= 10.0, 3.0 * t, np.where(t <= 20.0, 30.0 + 7.0 * (t - 10.0), 1e6))
    assert _predicted(t, log, 100.0) == pytest.approx(30.0 + 7.0 * 90.0)
    few = t <= 15.0  # of a session that ended early
    assert _predicted(t[few], log[few], 100.0) == pytest.approx(30.0 + 7.0 * 90.0)


def test_what_cyclictest_wrote_stands_beside_and_nothing_where_it_did_not_run(tmp_path: Path) -> None:
    output = tmp_path / "cyclictest.json"
    assert _beside(output, 1000) == (None, None)
    output.write_text(json.dumps({"thread": {"0": {"histogram": {"20": 97, "2500": 1}}}}))  # 1.5 and 0.5 ms late were missed
    late_us, missed = _beside(output, 1000)
    assert late_us is not None and (late_us["p50"], late_us["max"], missed) == (20.0, 2500.0, 0.02)
    output.write_text(json.dumps({"thread": {"0": {"histogram": {}}}}))
    assert _beside(output, 1000)[1] == 0.0


class Session:
    """A session on a clock of its own: its log grows by 1 kB each s, process n holds 1000 n kB and 10 kB more each s."""

    pid = 7

    def __init__(self, log: Path, monkeypatch: pytest.MonkeyPatch, *, lasts_s: float, rig_ends_s: float = np.inf) -> None:
        self._log, self._lasts_s, self._rig_ends_s, self._now_s = log, lasts_s, rig_ends_s, 0.0
        monkeypatch.setattr(soak, "pause", self._pause)
        monkeypatch.setattr(soak, "monotonic_ns", lambda: round(self._now_s * 1e9))
        monkeypatch.setattr(soak, "_processes", lambda pid: {name: pid + n for n, name in enumerate(PROCESSES)})
        monkeypatch.setattr(soak, "_resident_kb", self._resident_kb)

    def poll(self) -> int | None:
        return 0 if self._now_s >= self._lasts_s else None

    def _pause(self, duration_s: float) -> None:
        self._now_s += duration_s
        with open(self._log, "ab") as log:
            log.truncate(round(1000 * self._now_s))

    def _resident_kb(self, pid: int) -> int | None:
        gone = pid == self.pid + PROCESSES.index("rig") and self._now_s >= self._rig_ends_s
        return None if gone else round(1000 * (pid - self.pid) + 10 * self._now_s)


def test_a_session_is_watched_from_its_first_records_to_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The header of a log is 12 kB at most: here it holds records from second 13 on."""
    log = tmp_path / "0.mcap"
    seen = _watch(Session(log, monkeypatch, lasts_s=1000.0), log, 400.0)  # type: ignore[arg-type]
    assert seen.t_s == [float(t) for t in range(401)]
    assert seen.log == [1000 * (13 + t) for t in range(401)]
    assert seen.kb == {name: [1000.0 * n + 10.0 * (13 + t) for t in range(401)] for n, name in enumerate(PROCESSES)}


@pytest.mark.parametrize("how", [{"lasts_s": 100.0}, {"lasts_s": 1000.0, "rig_ends_s": 100.0}])
def test_a_session_that_ends_early_or_loses_a_process_is_watched_until_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: dict[str, float]
) -> None:
    log = tmp_path / "0.mcap"
    seen = _watch(Session(log, monkeypatch, **how), log, 400.0)  # type: ignore[arg-type]
    assert seen.t_s == [float(t) for t in range(87)]
    assert {len(kb) for kb in seen.kb.values()} == {len(seen.log)} == {87}


def test_the_processes_of_a_session_are_its_children_by_what_they_run_and_what_is_gone_has_no_memory() -> None:
    """The page that a process touches is resident; one that has ended and is not yet waited for holds none."""
    wait = "import sys; held = bytes(int(sys.argv[2])); print(flush=True); sys.stdin.read()"
    parent = (
        "import subprocess, sys\n"
        "run = lambda *words: subprocess.Popen([sys.executable, '-c', sys.argv[1], *words], stdin=0, stdout=subprocess.PIPE)\n"
        "found = [run(f'hil.runtime.real.{name}_process', size) for name, size in (('rig', '1'), ('controller', '1'))]\n"
        "found += [run('something.else', '1')]\n"
        "for each in found: each.stdout.readline()\n"
        "print(*(each.pid for each in found), flush=True)\n"
        "sys.stdin.read()\n"
        "for each in found: each.wait()\n"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", parent, wait], stdin=pipe, stdout=pipe, text=True) as session:
        assert session.stdin and session.stdout
        rig, controller, _ = map(int, session.stdout.readline().split())
        assert _processes(session.pid) == {"session": session.pid, "rig": rig, "controller": controller}
        resident = _resident_kb(rig)
        status = dict(line.split(":") for line in Path(f"/proc/{rig}/status").read_text().splitlines())
        assert resident is not None and abs(resident - int(status["VmRSS"].split()[0])) < 1024
        session.stdin.close()
        os.waitid(os.P_PID, session.pid, os.WEXITED | os.WNOWAIT)
        assert _resident_kb(session.pid) is None
    assert _resident_kb(rig) is None


def test_a_soak_is_of_what_its_sessions_and_cyclictest_wrote(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the place of sessions and of cyclictest: programs that end at once, and what those would have written."""
    asked: list[tuple[float, ...]] = []
    said: list[str] = []

    def start(folder: Path, number: int, duration_s: float) -> subprocess.Popen[bytes]:
        asked.append((number, duration_s))
        timing = {"late": 3, "overruns": 5, "lateness_us": {"p50": 9.0}, "why": ["late"]}
        summary = {"slots": 1000, "safety": None, "log": {"dropped": number}, "timing": timing}
        (folder / f"{number}.json").write_text(json.dumps(summary))
        (folder / f"{number}.mcap").write_bytes(bytes(2000))
        return subprocess.Popen([sys.executable, "-c", f"raise SystemExit({3 * (number > 1)})"])

    def beside(priority: int, period_us: int, duration_s: float, output: Path) -> subprocess.Popen[bytes]:
        asked.append((priority, period_us, duration_s))
        output.write_text(json.dumps({"thread": {"0": {"histogram": {"20": 97, "2500": 1}}}}))
        return subprocess.Popen(["true"])

    def watch(session: object, log: Path, duration_s: float) -> Samples:
        t = np.arange(1, 101) / 100.0
        kb = {"session": [1e4] * 100, "rig": [2e4] * 100, "controller": (1e4 + 1e5 * t).tolist()}
        return Samples(t.tolist(), kb, (1000 * t).tolist())

    for name, stands_in in (("SHORT_S", 0.2), ("_start", start), ("start_cyclictest", beside), ("_watch", watch)):
        monkeypatch.setattr(soak, name, stands_in)
    monkeypatch.setattr(soak.shutil, "which", lambda name: name)
    row = bench_soak(duration_s=1.0, sessions=2, at_once=3, progress=said.append)
    assert asked == [(60, 1000, 1.0), (0, 1.0), (1, 0.2), (1, 0.2), (1, 0.2), (2, 0.2), (3, 0.2)]
    assert said == [
        "1 kHz for 1 s over can:hil", "in a row: 1 of 2, 1 sessions of 0.2 s", "in a row: 2 of 2, 1 sessions of 0.2 s",
        "at once: 1 of 1, 3 sessions of 0.2 s",
    ]  # fmt: skip
    memory, beside_us = row.pop("memory"), row.pop("cyclictest_us")
    assert [each["grows"] for each in memory] == [False, False, True]
    assert [each["mb"] for each in memory] == pytest.approx([10.0, 20.0, 110.0])
    assert [each["slope_kb_per_min"] for each in memory] == pytest.approx([0.0, 0.0, 6e6])
    assert (beside_us["p50"], beside_us["max"]) == (20.0, 2500.0)
    assert (row.pop("log_predicted"), row.pop("log_ratio")) == pytest.approx((1000.0, 2.0))
    assert row.pop("verdict") == "does not hold" and "controller: memory grows" in row.pop("why")
    assert row == {
        "status": 0, "safety": None, "slots": 1000, "slots_expected": 1000, "dropped": 0, "late": 3, "overrun_share": 0.005,
        "lateness_us": {"p50": 9.0}, "timing_why": ["late"], "cyclictest_missed_share": 0.02, "log_bytes": 2000,
        "in_a_row": {"0": 2}, "at_once": {"0": 1, "3": 2}, "short_dropped": {"in a row": 2, "at once": 6},
    }  # fmt: skip
