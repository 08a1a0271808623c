"""A link is probed with our own frames, and its log is read back; the other end must be there."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from hil.bench.probe import monotonic_ns, own_boot, probe, write_probe_log
from hil.log.read import read_run
from hil.log.recordings import packet_records
from hil.log.recordings.read import read_recording
from tests.hil.cli.conftest import Hil, cli
from transport import ControlPacket, SensorPacket, decode, encode_control
from transport.links import LinkCounters

__all__ = ["cli"]


def test_a_probed_link_gives_both_directions(cli: Hil, tmp_path: Path) -> None:
    status, _, err = cli("probe", f"can:hil:probe-{os.getpid()}", "--both", "--seconds", "2", "--rate", "200", "-o", "link.mcap")
    assert status == 0, err
    assert "one clock" in err
    records, _ = packet_records(read_recording([tmp_path / "link.mcap"]))
    run = read_run(tmp_path / "link.mcap")
    found = run.arrays["/probe/packet"]
    assert len(found) == 400
    assert (np.diff(found["sent_ns"]) > 0).all()
    came = found["received_ns"] > 0
    assert came.mean() > 0.5
    both = records["sc"].latency_s[came] + records["ca"].latency_s
    np.testing.assert_allclose(both, (found["received_ns"] - found["sent_ns"])[came] * 1e-9, atol=1e-9)
    assert (both > 0).all()
    status, _, err = cli("probe", "can:hil:other", "--both", "-o", "link.mcap")
    assert status == 2 and "exists already" in err


def test_without_another_end_nothing_is_written(cli: Hil, tmp_path: Path) -> None:
    status, _, err = cli("probe", f"can:hil:alone-{os.getpid()}", "--seconds", "1", "-o", "link.mcap")
    assert status == 2
    assert f"hil probe can:hil:alone-{os.getpid()} --answer" in err
    assert not (tmp_path / "link.mcap").exists()
    for link in ("local:", "memory:", "cann:hil:x"):
        assert cli("probe", link, "-o", "link.mcap")[0] == 2
    assert cli("probe", "can:hil:x", "--answer", "--both")[0] == 2


class Liar:
    """The other end of a link, which dates its answers as it likes, or says them twice.

    Args:
        dates: `control_ns` of an answer.
        times: how often it is said.
    """

    uri, counters = "liar", LinkCounters()

    def __init__(self, dates: Callable[[int], int], times: int = 1) -> None:
        self._dates, self._times, self._said = dates, times, deque[bytes]()

    def send(self, packet: bytes) -> None:
        asked = decode(packet)
        assert isinstance(asked, SensorPacket)
        lie = self._dates(len(self._said))
        answer = ControlPacket(asked.seq, asked.sample_ns, lie, 0, 0, ((0.0,),), own_boot(), asked.counter)
        self._said.extend([encode_control(answer)] * self._times)

    def receive(self, timeout_s: float) -> bytes | None:
        return self._said.popleft() if self._said else None

    def close(self) -> None: ...


@pytest.mark.parametrize("answered_ns", [2**63 - 1, 1], ids=["future", "past"])
def test_an_end_that_dates_answers_before_the_question_or_after_their_arrival_has_another_clock(
    cli: Hil, tmp_path: Path, answered_ns: int
) -> None:
    trips, one_clock, _ = probe(Liar(lambda n: answered_ns), 2000.0, 0.2)
    assert not one_clock and all(trip.received_ns for trip in trips)
    write_probe_log(tmp_path / "link.mcap", "can:hil:x", 2000.0, trips, one_clock)
    status, _, err = cli("identify", "law", "link.mcap")
    assert status == 2 and err.startswith("hil: link.mcap: ") and err.count("\n") == 1, err  # the load decides which


def test_an_answer_of_an_instant_that_no_clock_reads_is_none(tmp_path: Path) -> None:
    lies = iter([1, *[-(2**63), 0] * 10**6])  # the greeting is answered
    trips, *_ = probe(Liar(lambda n: next(lies)), 2000.0, 0.02)
    assert not any(trip.received_ns for trip in trips)
    write_probe_log(tmp_path / "link.mcap", "can:hil:x", 2000.0, trips, False)
    assert (read_run(tmp_path / "link.mcap").arrays["/probe/packet"]["received_ns"] == 0).all()


def test_of_two_answers_the_first_counts() -> None:
    trips, one_clock, again = probe(Liar(lambda n: monotonic_ns(), times=2), 2000.0, 0.02)
    assert again == 0, "a link that doubles frames is no second answerer"
    assert one_clock and all(trip.sent_ns <= trip.answered_ns <= trip.received_ns for trip in trips)


class Late(Liar):
    """An end that is started a moment after the other: it has not heard the first greeting."""

    heard = False

    def send(self, packet: bytes) -> None:
        if self.heard:
            super().send(packet)
        self.heard = True


def test_an_end_that_comes_later_is_met() -> None:
    assert all(trip.received_ns for trip in probe(Late(lambda n: monotonic_ns()), 2000.0, 0.02).trips)


class Twins(Liar):
    """Two processes that answer on one link, as on a real bus with two machines; each reads its clock when it answers."""

    def send(self, packet: bytes) -> None:
        super().send(packet)
        super().send(packet)


def test_a_second_process_that_answers_is_named(cli: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("transport.links.opening.open_link", lambda *_: nullcontext(Twins(lambda n: monotonic_ns())))
    status, _, err = cli("probe", "can:socketcan:can0", "--seconds", "0.2", "-o", "link.mcap")
    assert status == 5
    assert "hil: link 'can:socketcan:can0': 20 of 20 frames were answered twice, at two instants: two processes answer" in err
    assert (read_run(tmp_path / "link.mcap").arrays["/probe/packet"]["received_ns"] > 0).all()
