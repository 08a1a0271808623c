"""`hil bench links` measures what it says; no test of how fast anything is."""

from __future__ import annotations

import io
import math
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.bench import links as ours
from hil.bench.links import FLOOR, PlainSocket, PlainZenoh, _trip, bench_links, drive
from tests.waiting import until
from transport import Role, TransportError, memory_pair
from transport.links import Closing, LinkCounters

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


def test_the_plainest_links_carry_packets_both_ways(tmp_path: Path) -> None:
    uri = f"plain-unix:{tmp_path}/s"
    with PlainSocket(uri, "controller") as controller, PlainSocket(uri, "rig") as rig:
        assert controller.receive(1.0) is None and rig.receive(0.0) is None  # 50 ms, whatever it is asked
        for packet in (b"first", b"second"):
            rig.send(packet)
            assert controller.receive(1.0) == packet
        controller.send(b"answer")
        assert (rig.receive(1.0), rig.receive(1.0)) == (b"answer", None)
    uri = f"plain-zenoh:unixsock-stream/{tmp_path}/z"
    with PlainZenoh(uri, "rig") as first, PlainZenoh(uri, "controller") as second:
        until(lambda: first.send(b"question") or second.receive(0.02) == b"question", "a question")
        until(lambda: second.send(b"answer") or first.receive(0.02) == b"answer", "an answer")
        assert second.counters.sent > 0 and second.counters.received == 1 and first.counters.received == 1


def test_a_trip_ends_with_its_own_answer_or_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, controller = memory_pair()
    questions = [bytes((0, 0, 0, 0, n)) for n in range(256)]
    for answer in (6, 7):
        controller.send(questions[answer])
    monkeypatch.setattr(ours, "PATIENCE_NS", 600 * 10**9)
    assert 0 < _trip(rig, questions, 256 + 7) < 600 * 10**9
    assert controller.receive(0) == questions[7]
    monkeypatch.setattr(ours, "PATIENCE_NS", 1_000_000)
    assert _trip(rig, questions, 8) == -1


class Mirror(Closing):
    """A link that answers by itself, once it was asked for the third time."""

    def __init__(self, uri: str, role: Role) -> None:
        self.uri, self.counters, self.asked, self.packet = uri, LinkCounters(), 0, b""

    def send(self, packet: bytes) -> None:
        self.asked, self.packet = self.asked + 1, packet

    def receive(self, timeout_s: float) -> bytes | None:
        return self.packet if timeout_s > 0 and self.asked > 2 else None

    def close(self) -> None:
        pass


def test_a_driving_process_meets_the_other_and_says_how_long_each_trip_took(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(ours._PEERS, "mirror", Mirror)
    monkeypatch.setattr(ours, "go_real_time", lambda *_, **__: None)
    monkeypatch.setattr(ours, "PATIENCE_NS", 1_000_000)
    monkeypatch.setattr(sys, "stdin", io.StringIO("3\n2\n"))
    drive("mirror:", "free", 1000.0)
    ready, *answers = capsys.readouterr().out.splitlines()
    assert ready == "ready" and [len(line.split()) for line in answers] == [3, 2]
    monkeypatch.setattr(ours, "MEETING_NS", 0)
    monkeypatch.setattr(Mirror, "receive", lambda link, timeout_s: None)
    with pytest.raises(TransportError, match="link 'mirror:': no answer within 0 s"):
        drive("mirror:", "free", 1000.0)
