"""What `hil bench` asks for and what it prints of it; tests/hil/bench has the measuring itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from click.testing import CliRunner, Result

from hil.cli import cli
from hil.errors import HilError

LATE = {"p50": 12.0, "p99": 34.5, "p99_9": 80.0, "max": None}
SOAK: dict[str, Any] = {
    "verdict": "does not hold", "why": ["rig: memory grows", "at once: 1 stopped by safety"], "status": 0, "safety": None,
    "slots": 600, "slots_expected": 601, "dropped": 7, "late": 5, "overrun_share": 0.0125, "lateness_us": LATE, "timing_why": [],
    "cyclictest_us": LATE | {"max": 99.0}, "cyclictest_missed_share": 0.5, "log_bytes": 4_200_000, "log_predicted": 4.0e6,
    "log_ratio": 1.05, "memory": [{"process": "rig", "mb": 61.5, "slope_kb_per_min": 3.0, "plus_minus": 1.0, "grows": True}],
    "in_a_row": None, "at_once": {"0": 2, "3": 1}, "short_dropped": {"at once": 4},
}  # fmt: skip
TIMING: dict[str, Any] = {
    "experiment": "e", "link": "can:hil:a", "affinity": "free", "lateness_us": LATE, "cyclictest_us": LATE, "ratio": LATE,
    "round_trip_us": {"p50": 150.0, "p99": 300.0}, "round_trip_ratio": 0.75, "late_share": 0.02, "overrun_share": 0.03,
    "cyclictest_missed_share": 0.04, "dropped_records": 6, "slots": 20_000, "scheduler": "SCHED_FIFO",
}  # fmt: skip
LIVE = {
    "readers": 3, "slots": 9, "lateness_us": {"p50": 11.0}, "pictures": 41, "missed": 2, "dropped_records": 1,
    "ratio": {"p50": 1.5},
}  # fmt: skip
BUS = {
    "bus": "hil", "frames_s": 5000.0, "times_off": 1.25, "p50_us": 70.0, "p99_us": 90.0, "trip_times_off": 0.5,
    "late_p50_us": 3.0, "late_p99_us": 4.0, "cyclictest_p99_us": 8.0, "late_of_cyclictest": 0.375, "lost": 17, "note": "",
}  # fmt: skip


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Result, dict[str, Any]]]:
    """Runs a command with an answer in the place of what it measures, and gives what it was asked for."""

    def run(name: str, answer: Any, *words: str) -> tuple[Result, dict[str, Any]]:
        asked: dict[str, Any] = {}

        def bench(*given: Any, progress: Callable[[str], None] = lambda text: None, **more: Any) -> Any:
            asked.update(more, given=given)
            progress("this takes a while")
            return answer

        monkeypatch.setattr(name, bench)
        return CliRunner(env={"COLUMNS": "200"}).invoke(cli, ["bench", *words]), asked

    return run


@pytest.mark.parametrize(("verdict", "status"), [("holds", 0), ("does not hold", 1), ("undecided", 4)])
def test_a_soak_says_what_it_saw_and_ends_by_its_verdict(measured: Any, verdict: str, status: int) -> None:
    done, asked = measured(
        "hil.bench.soak.bench_soak", SOAK | {"verdict": verdict}, "soak", "--for", "6s", "--sessions", "2", "--at-once", "3"
    )  # fmt: skip
    assert done.exit_code == status and asked == {"duration_s": 6.0, "sessions": 2, "at_once": 3, "given": ()}
    assert done.stderr == "this takes a while\n"
    for line in (
        "exit status 0, 600 of 601 slots, 7 records dropped", "log 4.2 MB, 1.050 of the 4.0 MB that its second tenth predicts",
        "overruns 1.250%, late answers 5, lateness p50 12 us, p99 34 us, p99.9 80 us, max - us",
        "cyclictest missed 50.000%, lateness p50 12 us, p99 34 us, p99.9 80 us, max 99 us",
        "at once: 2 ended with status 0, 1 ended with status 3; 4 records dropped",
        f"{verdict}\n  rig: memory grows\n  at once: 1 stopped by safety",
    ):  # fmt: skip
        assert line in done.stdout, done.stdout
    assert "61.5" in done.stdout and "in a row" not in done.stdout


def test_a_soak_without_cyclictest_says_how_to_get_it(measured: Any) -> None:
    done, asked = measured("hil.bench.soak.bench_soak", SOAK | {"cyclictest_us": None}, "soak")
    assert "no cyclictest here: apt-get install rt-tests" in done.stdout and asked["duration_s"] == 600.0
    assert json.loads(measured("hil.bench.soak.bench_soak", SOAK, "soak", "--json")[0].stdout) == SOAK


def test_timing_is_measured_as_asked_and_shown_by_rig_and_cyclictest(measured: Any) -> None:
    name = "hil.bench.timing.bench_timing"
    words = ("--duration", "8s", "--turns", "2", "--link", "can:hil:a", "--affinity", "free")
    done, asked = measured(name, [TIMING], "timing", *words)
    assert done.exit_code == 0 and asked["sets"] == () and asked["experiments"] == ("dc-motor-1khz",)
    assert (asked["duration_s"], asked["turns"], asked["links"], asked["affinities"]) == (8.0, 2, ("can:hil:a",), ("free",))
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert {f"e can:hil:a {name} 12 34.5 80 –" for name in ("rig", "cyclictest", "ratio")} <= {*lines}
    assert "e can:hil:a free 150 300 0.75 2.000% 3.000% 4.000% 6" in lines
    assert lines[-1] == "20000 slots for each link; SCHED_FIFO"
    refused, asked = measured(name, [TIMING], "timing", "--duration", "50ms", "--turns", "100")
    assert isinstance(refused.exception, HilError) and "expected 0.001 s at least" in str(refused.exception) and not asked
    refused, asked = measured(name, [TIMING], "timing", "--duration", "0.1ms")
    assert refused.exit_code == 2 and "expected a duration from 0.001 s" in refused.stderr and not asked


def test_readers_of_the_live_page_are_measured_on_the_first_link_and_experiment(measured: Any) -> None:
    words = ("--live", "--link", "zenoh:b", "--experiment", "dc-motor-h2", "--experiment", "other", "--turns", "1")
    done, asked = measured("hil.bench.timing.bench_live", [LIVE], "timing", *words)
    assert done.exit_code == 0, done.output
    assert (asked["link"], asked["experiment"], asked["turns"], asked["duration_s"]) == ("zenoh:b", "dc-motor-h2", 1, 20.0)
    assert "3 11 1.5 2 1 41" in [" ".join(line.split()) for line in done.stdout.splitlines()]


def test_links_and_can_buses_are_tables_of_their_own(measured: Any) -> None:
    done, asked = measured("hil.bench.can_buses.bench_can_buses", [BUS], "links", "--can", "--duration", "3s")
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert done.exit_code == 0 and asked["given"] == (3.0,) and {"hil 5000 1.25 17", "hil 70 90 0.5 3 4 8 0.375"} <= {*lines}
    rows = [{"link": "udp", "p50_us": 31.0}]
    done, asked = measured("hil.bench.links.bench_links", rows, "links", "--rate", "50", "--duration", "3s")
    assert done.exit_code == 0 and asked == {"rate_hz": 50.0, "duration_s": 3.0, "given": ()}
    assert "round trips at 50 Hz, us" in done.stdout and "31" in done.stdout
    for words, said in (
        (("--rate", "0.5"), "from 1 to 100000"), (("--rate", "200000"), "from 1 to 100000"),
        (("--duration", "0.1ms"), "duration from"),
    ):  # fmt: skip
        refused, asked = measured("hil.bench.links.bench_links", [], "links", *words)
        assert refused.exit_code == 2 and said in refused.stderr and not asked
