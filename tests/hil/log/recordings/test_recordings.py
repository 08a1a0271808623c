"""Every source gives the latencies that were put into it; what is no record of packets is refused, with file and remedy."""

from __future__ import annotations

import gzip
import os
import struct
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest
from numpy.typing import NDArray

import hil
from hil.bench.probe import Trip, write_probe_log
from hil.errors import HilError
from hil.log.recordings import packet_records
from hil.log.recordings import read as recordings_read
from hil.log.recordings.read import _emulated, read_recording, shipped_recordings
from tests.waiting import LIMIT_S
from transport.draws import DELIVERED, SUPERSEDED
from transport.law_fit import fit_law
from transport.packets import ControlPacket, SensorPacket, encode_control, encode_sensor

DATA = Path(__file__).parents[3] / "data"
N = 400
SENT = np.arange(N) * 0.01
LATENCY = np.random.default_rng(0).gamma(2.0, 1e-3, N) + 1e-3
LOST = np.random.default_rng(1).random(N) < 0.05


def only(paths: list[Path], **how: bool | int) -> NDArray[np.float64]:
    records, _ = packet_records(read_recording(paths, **how))  # type: ignore[arg-type]
    (record,) = records.values()
    return record.latency_s


def table(path: Path, head: str, rows: list[str]) -> Path:
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def test_tables_of_latencies_and_of_time_stamps(tmp_path: Path) -> None:
    expected = np.where(LOST, np.nan, LATENCY)
    entries = ["lost" if np.isnan(v) else repr(v * 1e3) for v in expected.tolist()]
    plain = table(tmp_path / "a.csv", "latency_ms", entries)
    np.testing.assert_allclose(only([plain]), expected, rtol=1e-12)
    empty = table(tmp_path / "empty.csv", "latency_ms", ["" if e == "lost" else e for e in entries] + ["", ""])
    np.testing.assert_allclose(only([empty]), expected, rtol=1e-12)  # an empty line of the only column was lost, too
    assert read_recording([plain]).ways["sc"].sent_s.tolist() == [*range(N)]
    assert "one a slot (of 1 s without --period)" in read_recording([plain]).notes[0]
    stamped = table(tmp_path / "b.csv", "sent_s [s],received_s [s]", [
        f"{s!r},{'' if np.isnan(v) else repr(s + v)}" for s, v in zip(SENT.tolist(), expected.tolist())
    ])  # fmt: skip
    np.testing.assert_allclose(only([stamped], one_clock=True), expected, atol=1e-12)
    spreadsheet = table(tmp_path / "d.csv", "sent_s;latency_ms", [
        f"{s!r};{e}".replace(".", ",") for s, e in zip(SENT.tolist(), entries)
    ])  # fmt: skip
    np.testing.assert_allclose(only([spreadsheet]), expected, rtol=1e-12)
    trips = table(tmp_path / "c.csv", "sent_s,rtt_s", [f"{s!r},{v!r}" for s, v in zip(SENT.tolist(), LATENCY.tolist())])
    halves, notes = packet_records(read_recording([trips]), halve=True)
    np.testing.assert_allclose(halves["ca"].latency_s, LATENCY / 2.0)
    assert any("by choice" in note for note in notes)
    assert [*packet_records(read_recording([trips]))[0]] == ["round trip"]


def test_two_tables_of_two_clocks_say_offset_and_drift(tmp_path: Path) -> None:
    ahead, drift = 12.0, 30e-6
    paths = []
    for name, sign in (("there", 1.0), ("back", -1.0)):
        rows = [f"{s!r},{s + v + sign * (ahead + drift * s)!r}" for s, v in zip((SENT * 50).tolist(), LATENCY.tolist())]
        paths.append(table(tmp_path / f"{name}.csv", "sent_s,received_s", rows))
    records, notes = packet_records(read_recording(paths))
    for record in records.values():
        np.testing.assert_allclose(record.latency_s, LATENCY, atol=4e-4)
    said = " ".join(notes)
    assert "drift" in said and "ppm" in said and "taken out" in said and "offset between the clocks 12" in said


def test_latencies_that_grow_in_both_directions_stay_as_they_are(tmp_path: Path) -> None:
    """A queue that fills: a drift of 250 ppm in either direction was taken out, and half of the mean latency with it."""
    ahead, drift, rise, rng = 12.0, 30e-6, 250e-6, np.random.default_rng(3)
    sent, paths, grown = np.arange(2000) * 0.01, [], {}
    for name, sign in (("sc", 1.0), ("ca", -1.0)):
        grown[name] = 1e-3 + rng.exponential(1e-3, sent.size) + rise * sent
        rows = [f"{s!r},{s + v + sign * (ahead + drift * s)!r}" for s, v in zip(sent.tolist(), grown[name].tolist())]
        paths.append(table(tmp_path / f"{name}.csv", "sent_s,received_s", rows))
    records, notes = packet_records(read_recording(paths))
    for name, record in records.items():
        np.testing.assert_allclose(record.latency_s, grown[name], atol=1e-4)
    assert any("the least latency rises by 25" in note and "which no clock does: it stays in" in note for note in notes)


@pytest.mark.parametrize("ending", [".log", ".asc", ".blf"])
def test_one_bus_seen_twice(tmp_path: Path, ending: str) -> None:
    begin = 1_700_000_000.0
    paths = [tmp_path / f"{name}{ending}" for name in ("sender", "receiver")]
    for path, shift, skip in ((paths[0], 0.0 * LATENCY, LOST & False), (paths[1], LATENCY, LOST)):
        order = np.argsort(SENT + shift, kind="stable")
        with can.Logger(str(path)) as log:
            for k in order.tolist():
                if not skip[k]:
                    at, data = begin + SENT[k] + shift[k], k.to_bytes(4, "little")
                    log(can.Message(timestamp=at, arbitration_id=0x101, data=data, is_extended_id=False))
    if ending == ".asc":  # its times count from the first frame, which makes two clocks of them
        assert "the times of an .asc count from the beginning of its own file" in fails(paths)
    else:
        np.testing.assert_allclose(only(paths, one_clock=True, can_id=0x101), np.where(LOST, np.nan, LATENCY), atol=2e-6)
    with pytest.raises(HilError, match="no frame of identifier 0x7; what a log writes as 123 is --can-id 0x123"):
        read_recording(paths, can_id=7)


def test_requests_and_their_answers_in_one_log_are_round_trips(tmp_path: Path) -> None:
    """Another identifier stands between; what has no answer before the next request is lost."""
    lines = [(t, "201#00") for t in SENT] + [(t + rtt, "181#00") for t, rtt, lost in zip(SENT, LATENCY, LOST) if not lost]
    lines += [(SENT[~LOST][9] + 0.0099, "181#00"), (-0.5, "181#00"), *((t + 1e-4, "123#00") for t in SENT)]
    (tmp_path / "bus.log").write_text("".join(f"({100 + t:.6f}) can0 {frame}\n" for t, frame in sorted(lines)))
    recording = read_recording([tmp_path / "bus.log"], can_id=0x201, answer_id=0x181)
    way = recording.ways["round trip"]
    np.testing.assert_allclose(way.sent_s, 100 + SENT, atol=1e-6)
    assert LATENCY.max() < 0.0099
    np.testing.assert_allclose(way.difference_s, np.where(LOST, np.nan, LATENCY), atol=2e-6)
    assert recording.clocks == 1 and "an answer is that to the newest request" in recording.notes[0]
    assert recording.notes[1:] == ("1 answers came behind the first", "1 answers to no request")
    for can_id, answer_id, said in (
        (0x200, 0x181, "bus.log: no frame of identifier 0x200"),
        (0x201, 0x180, "bus.log: no frame behind one of --can-id has the identifier 0x180"),
        (0x201, 0x201, "--answer-id: is for one CAN log, with --can-id for the frames that are answered"),
        (None, 0x181, "--answer-id: is for one CAN log"),
    ):
        with pytest.raises(HilError, match=said):
            read_recording([tmp_path / "bus.log"], can_id=can_id, answer_id=answer_id)


def test_what_was_sent_while_the_other_log_did_not_run_is_not_lost(tmp_path: Path) -> None:
    paths = [tmp_path / "sender.log", tmp_path / "receiver.log"]
    for path, shift, kept in ((paths[0], 0.0, range(1000)), (paths[1], 1e-3, sorted({*range(200, 900)} - {300, 301}))):
        with can.Logger(str(path)) as log:
            for k in kept:
                data = k.to_bytes(4, "little")
                log(can.Message(timestamp=1e9 + 0.01 * k + shift, arbitration_id=0x101, data=data, is_extended_id=False))
    recording = read_recording(paths, one_clock=True)
    way = recording.ways["sc"]
    assert len(way.sent_s) == 700 and int(np.isnan(way.difference_s).sum()) == 2
    assert "2 of 700 frames" in recording.notes[0] and recording.notes[1].startswith("300 frames of")


def test_two_logs_that_share_no_frame_or_too_many_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [tmp_path / "sender.log", tmp_path / "receiver.log"]
    for path, kept in zip(paths, (range(10), range(8, 12))):
        with can.Logger(str(path)) as log:
            for k in kept:
                log(can.Message(timestamp=1e9 + k, arbitration_id=0x101, data=[k], is_extended_id=False))
    recording = read_recording(paths, one_clock=True)
    assert recording.ways["sc"].difference_s.tolist() == [0.0, 0.0]
    assert recording.notes[2] == f"2 frames are in {paths[1]} alone: left out"
    monkeypatch.setattr(recordings_read, "MOST_FRAMES", 4)
    with pytest.raises(HilError, match=r"sender\.log: more than 4 frames"):
        read_recording(paths)
    monkeypatch.setattr(recordings_read, "MOST_FRAMES", 10)
    paths[1].write_text(paths[1].read_text().replace("101#", "102#"))
    with pytest.raises(HilError, match="no frame is in both; expected two logs of one bus at one time"):
        read_recording(paths)


@pytest.mark.parametrize(
    ("lacks", "said"),
    [("/network/ca", "has no packets; expected a log of `hil probe` or of a run"), ("period", "period: missing, expected"),
     ("one node", "several sensor nodes; a law is fitted to one")],
)  # fmt: skip
def test_a_log_that_has_no_packets_of_one_way_is_refused(lacks: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    run = hil.run("dc-motor-two-nodes" if lacks == "one node" else "dc-motor-hinf", duration=1).run
    run.arrays.pop(lacks, None)
    run.resolved.pop(lacks, None)
    monkeypatch.setattr(recordings_read, "read_run", lambda path: run)
    assert said in fails([Path("a.mcap")])


@pytest.mark.parametrize("one_clock", [True, False])
def test_probes_that_overtake_are_read_as_they_were_sent_back(tmp_path: Path, one_clock: bool) -> None:
    sent, late = range(10**6, 10**9, 10**6), (5 * 10**6, 10**6) * 500
    trips = [Trip(at, at + way, at + way + 10**6) for at, way in zip(sent, late)]
    write_probe_log(tmp_path / "link.mcap", "can:hil:x", 1000.0, trips, one_clock=one_clock)
    recording = read_recording([tmp_path / "link.mcap"])
    records, notes = packet_records(recording)
    assert recording.clocks == (1 if one_clock else 2) and any("offset between the clocks" in note for note in notes) != one_clock
    if not one_clock:
        return
    assert {*np.round(records["sc"].latency_s, 6).tolist()} == {0.001, 0.005}
    np.testing.assert_allclose(records["ca"].latency_s, 0.001, atol=1e-9)


def test_ages_that_a_law_delivers_are_latencies_and_what_was_overtaken_has_not_come_by_then() -> None:
    draws = np.zeros(6, [("slot", "i8"), ("packet_slot", "i8"), ("mode", "i4"), ("reason", "u1"), ("latency_s", "f8")])
    draws["slot"], draws["packet_slot"] = [0, 1, 2, 3, 4, 5], [0, 0, 2, -1, 2, 4]
    draws["reason"] = [DELIVERED, DELIVERED, DELIVERED, DELIVERED, SUPERSEDED, DELIVERED]
    way = _emulated("x", draws, 0.5)
    assert way.sent_s.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    np.testing.assert_array_equal(way.difference_s, [0.0, np.nan, 0.0, np.nan, 0.5, np.nan])
    assert way.until_s is not None and way.until_s.tolist() == [3.0, 0.5, 2.0, 1.0, 1.0, 0.5]
    draws["packet_slot"][-1] = 6
    with pytest.raises(HilError, match="x: a packet arrives before it is sent"):
        _emulated("x", draws, 0.5)


def capture(
    path: Path, *, replies: bool = True, order: str = "<", magic: int = 0xA1B2C3D4, twice: int = 0, strays: int = 0
) -> Path:
    """Ethernet, IPv4, ICMP echo: what `tcpdump -w` writes of ping."""
    frames = []
    for k in range(N):
        for kind, t in ((8, SENT[k]), (0, SENT[k] + LATENCY[k])):
            if kind == 8 or (replies and not LOST[k]):
                addresses = (b"\n\0\0\1", b"\n\0\0\2")[:: 1 if kind == 8 else -1]
                ip = struct.pack(">BBHHHBBH", 0x45, 0, 28, 0, 0, 64, 1, 0) + b"".join(addresses)
                frames.append((t, b"\0" * 12 + b"\x08\0" + ip + struct.pack(">BBHHH", kind, 0, 0, 77, k)))
    answers = [each for each in frames if each[1][34] == 0]
    frames += [(t + 0.5, data) for t, data in answers[:twice]]  # the same again
    frames += [(t, data[:-4] + struct.pack(">HH", 78, 0)) for t, data in answers[:strays]]  # of another program's ping
    frames.sort()
    with path.open("wb") as file:
        file.write(struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, 1))
        for t, data in frames:
            file.write(struct.pack(order + "IIII", 1_700_000_000 + int(t), round(t % 1 * 1e6), len(data), len(data)) + data)
    return path


def test_a_log_of_odd_lines_prints_nothing_of_each(tmp_path: Path) -> None:
    """Python prints the warnings of a library for which nobody asked: python-can has one for every such line."""
    head = "date Thu Jan 1 00:00:00.000 am 1970\nbase hex  timestamps absolute\ninternal events logged\n"
    line = "   {:.6f} CANFD 1 Rx 123                    0 0 8  4 {:02x} 22 33 44   130000  130   203000 0 0 0 0 0\n"
    for name in ("sender", "receiver"):
        (tmp_path / f"{name}.asc").write_text(head + "".join(line.format(k / 10, k) for k in range(9)))
    command = [str(Path(sys.executable).with_name("hil")), "identify", "law", "sender.asc", "receiver.asc", "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and "9 packets, expected at least 299" in done.stderr


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_capture_of_ping(tmp_path: Path, order: str) -> None:
    np.testing.assert_allclose(only([capture(tmp_path / "ping.pcap", order=order)]), np.where(LOST, np.nan, LATENCY), atol=2e-6)


def test_replies_that_come_twice_or_to_no_request_are_counted_and_said(tmp_path: Path) -> None:
    recording = read_recording([capture(tmp_path / "ping.pcap", twice=3, strays=5)])
    (record,) = packet_records(recording)[0].values()
    np.testing.assert_allclose(record.latency_s, np.where(LOST, np.nan, LATENCY), atol=2e-6)
    said = " ".join(recording.notes)
    assert "3 replies came twice: the first counts" in said and "5 replies to no request" in said
    quiet = " ".join(read_recording([capture(tmp_path / "ping.pcap")]).notes)
    assert "replies came twice" not in quiet and "replies to no request" not in quiet


LINKS = {1: 14, 12: 0, 14: 0, 101: 0, 113: 16, 228: 0, 229: 0, 276: 20, 0: 4, 108: 4}
"""Bytes before an IP packet, by link type: LINKTYPE_ETHERNET, RAW, IPV4, IPV6, LINUX_SLL, LINUX_SLL2, NULL, LOOP."""


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize(("magic", "per_s"), [(0xA1B2C3D4, 1e6), (0xA1B23C4D, 1e9)])
def test_a_capture_of_ping_over_ipv6_on_any_link(tmp_path: Path, link: int, magic: int, per_s: float) -> None:
    """Three requests, of which the second has no answer; a packet of another protocol and one of version 5 are none."""
    path, here, there = tmp_path / "ping.pcap", bytes(15) + b"\1", bytes(15) + b"\2"
    frames = [(0.0, 58, 128, 0), (0.25, 58, 129, 0), (1.0, 58, 128, 1), (1.1, 17, 129, 1), (2.0, 58, 128, 2), (2.5, 58, 129, 2)]
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", magic, 2, 4, 0, 0, 65535, link))
        for t, protocol, kind, number in [(0.0, 58, 128, -1), *frames]:
            ends = here + there if kind == 128 else there + here
            first = 0x60000000 if number >= 0 else 0x50000000
            data = bytes(LINKS[link]) + struct.pack(">IHBB", first, 8, protocol, 64) + ends
            data += struct.pack(">BBHHH", kind, 0, 0, 77, max(number, 0))
            file.write(struct.pack("<IIII", 9 + int(t), round(t % 1 * per_s), len(data), len(data)) + data)
    way = read_recording([path]).ways["round trip"]
    assert way.sent_s.tolist() == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(way.difference_s, [0.25, np.nan, 0.5], rtol=1e-6)


def zenoh_echo(path: Path, *, ports: tuple[int, ...] = ()) -> Path:
    """What tcpdump took on lo beside `hil probe zenoh:tcp/127.0.0.1:17447 --both`; of these destination ports only."""
    data = gzip.decompress((DATA / "zenoh-echo.pcap.gz").read_bytes())
    kept, at = [data[:24]], 24
    while at < len(data):
        end = at + 16 + int.from_bytes(data[at + 8 : at + 12], "little")
        to = int.from_bytes(data[at + 16 + 36 : at + 16 + 38], "big")  # Ethernet 14, IP 20, then source and destination
        kept += [data[at:end]] if not ports or to in ports else []
        at = end
    path.write_bytes(b"".join(kept))
    return path


def test_a_capture_of_frames_over_zenoh(tmp_path: Path) -> None:
    """326 round trips at 100 Hz on one machine, the greeting among them: none lost, and most take less than a millisecond."""
    records, notes = packet_records(read_recording([zenoh_echo(tmp_path / "link.pcap")]))
    (record,) = records.values()
    assert [*records] == ["round trip"] and "our own frames" in notes[0]
    assert len(record.latency_s) == 326 and record.came.all()
    assert 1e-4 < np.median(record.latency_s) < 1e-3
    assert record.period_s == pytest.approx(0.01, rel=0.1)
    assert fit_law(record).law_class == "independent"
    both = {int.from_bytes(zenoh_echo(tmp_path / "all.pcap").read_bytes()[24 + 16 + i : 24 + 18 + i], "big") for i in (34, 36)}
    refused = [fails([zenoh_echo(tmp_path / "one.pcap", ports=(port,))]) for port in both]
    for lacks in ("sensor frames, and no answer", "control frames, and no sensor frame that they answer"):
        assert sum(f"one.pcap: {lacks}: a capture of one direction" in said for said in refused) == 1


@pytest.mark.parametrize("version", [4, 6])
@pytest.mark.parametrize("protocol", [6, 17])
def test_frames_are_found_in_segments_of_every_kind(tmp_path: Path, version: int, protocol: int) -> None:
    """A question at 1 s, asked again at 1.1 s, and its answer at 1.25 s, twice; what stands around the frames is passed over."""
    question = encode_sensor(SensorPacket(7, 0, 9, (0.5,), nonce=3, counter=1))
    answer = encode_control(ControlPacket(7, 9, 11, 0, 1, ((0.5,), (0.25,)), echo=3, counter=1))
    head = {6: bytes(12) + b"\x50" + bytes(7), 17: bytes(8)}[protocol]
    with (tmp_path / "link.pcap").open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101))
        for t, frame in ((1.0, question), (1.1, question), (1.25, answer), (1.3, answer)):
            segment = head + b"??" + frame + b"?"
            ip = struct.pack(">BBHHHBBH8s", 0x45, 0, 20 + len(segment), 0, 0, 64, protocol, 0, bytes(8))
            ip = ip if version == 4 else struct.pack(">IHBB32s", 6 << 28, len(segment), protocol, 64, bytes(32))
            data = ip + segment + b"padding"
            file.write(struct.pack("<IIII", int(t), round(t % 1 * 1e6), len(data), len(data)) + data)
    way = read_recording([tmp_path / "link.pcap"]).ways["round trip"]
    np.testing.assert_allclose(way.sent_s, [0.0], atol=1e-9)
    np.testing.assert_allclose(way.difference_s, [0.25], rtol=1e-6)


def test_a_run_gives_back_the_laws_of_its_network(tmp_path: Path) -> None:
    """Both directions of a log in virtual time: a packet law there, the Markov chain of the thesis back."""
    session = hil.run("dc-motor-packets", duration=100, log=tmp_path / "run.mcap")
    assert session.status == 0
    records, _ = packet_records(read_recording([tmp_path / "run.mcap"]))
    assert {way: fit_law(record, 0.05, 0.03).law_class for way, record in records.items()} == {
        "sc": "gilbert-elliott", "ca": "independent",
    }  # fmt: skip
    hil.run("dc-motor-hinf", duration=150, log=tmp_path / "markov.mcap")
    records, _ = packet_records(read_recording([tmp_path / "markov.mcap"]))
    fit = fit_law(records["ca"], 0.05, 0.03)
    assert fit.law_class == "markov"
    low, high = fit.ages.intervals["matrix[1][0]"] if fit.ages else (0.0, 0.0)
    assert low < 0.7 < high


def fails(paths: list[Path], **how: bool) -> str:
    with pytest.raises(HilError) as error:
        packet_records(read_recording(paths, **how))  # type: ignore[arg-type]
    assert error.value.status == 2
    return str(error.value)


def test_bad_input_is_refused_with_its_place_and_the_remedy(tmp_path: Path) -> None:
    good = [repr(v) for v in LATENCY.tolist()]
    negative = table(tmp_path / "negative.csv", "latency_s", [*good[:3], "-0.001", *good])
    assert "negative.csv:5: latency_s: -0.001 is negative" in fails([negative])
    few = fails([table(tmp_path / "few.csv", "latency_s", good[:20])])
    assert "20 packets, expected at least 299" in few
    rows = [f"{s},{s + 0.001}" for s in SENT.tolist()]
    rows[7], rows[8] = rows[8], rows[7]
    at_once = [f"{s},{s + 0.001}" for s in np.repeat(SENT, 2).tolist()]
    assert len(only([table(tmp_path / "pairs.csv", "sent_s,received_s", at_once)], one_clock=True)) == 2 * N
    said = fails([table(tmp_path / "back.csv", "sent_s,received_s", rows)])
    assert "back.csv:10: sent_s" in said and "run backwards" in said
    assert "capture of one direction" in fails([capture(tmp_path / "one.pcap", replies=False)])
    assert "a CAN log has no latencies by itself" in fails([tmp_path / "one.log"])
    assert "names no column of latencies" in fails([table(tmp_path / "other.csv", "a,b", ["1,2"])])
    assert "comma.csv:2: 2 entries, the first line has 1; numbers have a decimal point" in fails(
        [table(tmp_path / "comma.csv", "latency_ms", ["3,5", "4,5"])]
    )
    assert "bad.csv:3: 'soon' is no number" in fails([table(tmp_path / "bad.csv", "latency_s", ["0.1", "soon"])])
    assert "names no record of packets" in fails([tmp_path / "x.txt"])
    before = [f"{s},{s - 0.001}" for s in SENT.tolist()]
    assert "before sent_s, of one clock" in fails([table(tmp_path / "early.csv", "sent_s,received_s", before)], one_clock=True)
    assert "of two logs the sender's stands first" in fails([tmp_path / "early.csv"])
    pcapng = tmp_path / "new.pcap"
    pcapng.write_bytes(b"\n\r\r\n" + bytes(40))
    assert "pcapng" in fails([pcapng])
    (tmp_path / "usb.pcap").write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 189))
    assert "link type 189, expected one of 0, 1, 12, 14, 101, 108, 113, 228, 229, 276" in fails([tmp_path / "usb.pcap"])
    long = capture(tmp_path / "long.pcap").read_bytes()
    (tmp_path / "long.pcap").write_bytes(long[:32] + struct.pack("<I", (1 << 18) + 1) + long[36:])
    assert "long.pcap: a packet of 262145 bytes at byte 24, at most 262144" in fails([tmp_path / "long.pcap"])
    for cut in (0, 10, 23):
        (tmp_path / "cut.pcap").write_bytes(bytes(cut))
        assert "no pcap capture" in fails([tmp_path / "cut.pcap"])


def test_a_capture_without_an_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of holes has as many empty packets as it likes, and takes no room on a disk."""
    monkeypatch.setattr("hil.log.recordings.packet_files.MOST_FRAMES", 2 * N)
    assert len(only([capture(tmp_path / "whole.pcap")])) == N
    monkeypatch.setattr("hil.log.recordings.packet_files.MOST_FRAMES", 50)
    assert "whole.pcap: more than 50 packets; divide it" in fails([tmp_path / "whole.pcap"])
    (tmp_path / "holes.pcap").write_bytes((tmp_path / "whole.pcap").read_bytes()[:24])
    os.truncate(tmp_path / "holes.pcap", 1 << 40)
    assert "holes.pcap: more than 50 packets" in fails([tmp_path / "holes.pcap"])


def test_files_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    plain = table(tmp_path / "a.csv", "latency_s", [repr(v) for v in LATENCY.tolist()])
    trips = table(tmp_path / "trips.csv", "rtt_s", [repr(v) for v in LATENCY.tolist()])
    empty = tmp_path / "empty.mcap"
    for paths, how, said in (
        ([plain], {"can_id": 7}, "a.csv: --can-id: belongs to CAN logs (.log, .asc, .blf"),
        ([plain, plain, plain], {}, "expected one file, or two CAN logs of one bus, or two tables (.csv) of both directions"),
        ([plain, empty], {}, "expected one file, or two CAN logs of one bus, or two tables"),
        ([plain, tmp_path / "b.log"], {}, "expected one file, or two CAN logs of one bus, or two tables"),
        ([tmp_path / f"b{ending}" for ending in (".log", ".asc", ".blf")], {}, "a CAN log has no latencies by itself"),
        ([plain, trips], {}, "two tables are both directions; expected latencies or time stamps, and no round trips"),
        ([trips, plain], {}, "two tables are both directions; expected latencies or time stamps, and no round trips"),
        ([plain], {"halve": True}, "--halve: these are no round trips, but sc"),
    ):  # fmt: skip
        halve = bool(how.pop("halve", False))
        with pytest.raises(HilError) as refused:
            packet_records(read_recording(paths, **how), halve=halve)  # type: ignore[arg-type]
        assert said in str(refused.value), refused.value
    records, notes = packet_records(read_recording([trips]), halve=True)
    assert set(records) == {"sc", "ca"} and "each direction is half of a round trip, by choice" in notes[-1]


def test_two_logs_of_two_buses_have_no_frame_in_common(tmp_path: Path) -> None:
    paths = [tmp_path / "a.log", tmp_path / "b.log"]
    for path, identifier in zip(paths, (1, 2)):
        with can.Logger(str(path)) as log:
            for k in range(400):
                log(can.Message(timestamp=1e9 + k, arbitration_id=identifier, data=k.to_bytes(4, "little"), is_extended_id=False))
    assert "no frame is in both; expected two logs of one bus at one time" in fails(paths)


def test_frames_that_repeat_and_get_lost_cannot_be_paired(tmp_path: Path) -> None:
    paths = [tmp_path / "a.log", tmp_path / "b.log"]
    for there in (N, 2):
        for path, n in zip(paths, (there, there - 1)):
            with can.Logger(str(path)) as log:
                for k in range(n):
                    log(can.Message(timestamp=1e9 + k, arbitration_id=1, data=b"same", is_extended_id=False))
        assert f"is there {there} times, in {paths[1]} {there - 1} times: which was lost cannot be said" in fails(paths)


def test_shipped_recordings_are_of_real_links_and_say_so() -> None:
    """Of 2000 packets each none was lost; latencies of a busy machine depend on each other, and hil says so."""
    assert [*shipped_recordings()] == ["vcan-busy", "zenoh-loopback"]
    for name in shipped_recordings():
        recording = read_recording([Path(name)])
        assert recording.clocks == 1
        for record in packet_records(recording)[0].values():
            assert len(record.latency_s) == 2000
            fit = fit_law(record, 0.02, 0.012)
            assert not fit.tested.independent
            assert fit.law_class in ("markov", "semi-markov", "independent")
    records, _ = packet_records(read_recording([Path("vcan-busy")]))
    assert {fit_law(record, 0.05, 0.03).law_class for record in records.values()} == {"independent"}
