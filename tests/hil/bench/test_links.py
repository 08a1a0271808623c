"""`hil bench links` measures what it says; no test of how fast anything is."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.bench.links import FLOOR, bench_links

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler: apt-get install gcc")


@pytest.fixture(autouse=True)
def bus_directory(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="hil-test-") as path:
        monkeypatch.setenv("HIL_CAN_DIR", path)
        yield Path(path)


@needs_compiler
def test_every_link_gets_a_row_with_its_ratio_to_the_floor_and_nothing_stays_behind(bus_directory: Path) -> None:
    plain = ("plain-zenoh:unixsock-stream/{folder}/plain", "plain-unix:{folder}/sockets")
    links = ("can:hil:bench", "zenoh:tcp/127.0.0.1:{port}", *plain)
    rows = bench_links(500.0, 0.2, links=links)
    assert [(row["link"], row["affinity"]) for row in rows] == [
        (FLOOR, "free"), ("can:hil:bench", "free"), ("zenoh:tcp/127.0.0.1:*", "free"), ("zenoh:tcp/127.0.0.1:*", "shared"),
        ("plain-zenoh:unixsock-stream/*/plain", "free"), ("plain-unix:*/sockets", "free"),
    ]  # fmt: skip
    for row in rows:
        assert row["note"] == "" and 0 <= row["lost"] < 100 and row["lost"] / 100 <= row["late_share"] <= 1
        assert 0 < row["p50_us"] <= row["p99_us"] <= row["p99_9_us"]
        assert row["times_floor"] == pytest.approx(row["p50_us"] / rows[0]["p50_us"])


def test_without_a_compiler_the_links_are_measured_and_one_that_cannot_be_had_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    floor, link, broken = bench_links(500.0, 0.1, links=("can:hil:bench", "can:nosuch:x"))
    assert "no C compiler" in floor["note"] and math.isnan(floor["p50_us"])
    assert link["p50_us"] > 0 and math.isnan(link["times_floor"])
    assert "python-can has no interface 'nosuch'" in broken["note"] and math.isnan(broken["p50_us"])
