"""Torn and damaged logs: what reading says, and what recovery saves."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import pytest
from click.testing import CliRunner
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

from hil.cli.log_files import recover as command
from hil.errors import HilError
from hil.log.read import Run, read_run
from hil.log.read.mcap_walk import MAGIC, walk
from hil.log.read.recover import recover
from hil.log.write.mcap_writer import McapWriter
from tests.file_limit import files_up_to
from tests.hil.log.recording import assert_same_arrays, provenance, record_chunks
from tests.waiting import LIMIT_S


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A closed log of ten chunks."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    record_chunks(path, 10)
    return path.read_bytes()


def offsets(data: bytes, opcode: int) -> list[int]:
    return [r.offset for r in walk(BytesIO(data), len(data)) if r.opcode == opcode]


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def states(run: Run) -> list[int]:
    return [int(k) for k in run.arrays["/plant/state"]["slot"]]


def test_a_whole_log_is_rebuilt_to_the_same_run(log: bytes, tmp_path: Path) -> None:
    source = written(tmp_path / "a.mcap", log)
    report = recover(source, tmp_path / "b.mcap")
    one, two = read_run(source), read_run(tmp_path / "b.mcap")
    assert_same_arrays(two.arrays, one.arrays)
    assert (two.events, two.summary, two.metadata, two.resolved) == (one.events, one.summary, one.metadata, one.resolved)
    assert report.closed and not report.losses
    assert report.messages == sum(map(len, one.arrays.values())) + len(one.events)
    assert "lost: nothing" in report.text


def test_a_log_torn_in_a_chunk_keeps_every_chunk_before_it(log: bytes, tmp_path: Path) -> None:
    cut = offsets(log, Opcode.CHUNK)[7] + 50
    source = written(tmp_path / "a.mcap", log[:cut])
    with pytest.raises(HilError, match=rf"a\.mcap: torn at byte {cut - 50}: .* hil recover .*a\.mcap$"):
        read_run(source)
    report = recover(source, tmp_path / "b.mcap")
    run = read_run(tmp_path / "b.mcap")
    assert states(run) == list(range(140)) == states(read_run(source, whole=False))
    assert run.resolved == provenance().resolved
    assert (report.chunks, report.lost_bytes, report.closed) == (7, 50, False)
    assert report.last_ns == 139_000_000
    assert f"lost: 50 bytes, torn at byte {cut - 50}" in report.text
    assert source.read_bytes() == log[:cut]
    with open(tmp_path / "b.mcap", "rb") as file:  # indexed: mcap's own reader seeks in it
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert (reader.get_header().profile, reader.get_header().library) == ("ros2", "hilrig")
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == report.messages


def test_a_time_stamp_of_64_bits_is_kept(tmp_path: Path) -> None:
    latest = (1 << 64) - 1
    with open(tmp_path / "foreign.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/clock", "json", writer.register_schema("Clock", "jsonschema", b"{}"))
        for time in (5, latest):
            writer.add_message(channel, time, b"{}", time)
        writer.finish()
    assert recover(tmp_path / "foreign.mcap", tmp_path / "b.mcap").messages == 2
    with open(tmp_path / "b.mcap", "rb") as file:
        times = [message.log_time for _, _, message in make_reader(file, validate_crcs=True).iter_messages()]
    assert times == [5, latest]


def test_a_log_with_something_behind_its_end_was_not_closed(log: bytes, tmp_path: Path) -> None:
    report = recover(written(tmp_path / "a.mcap", log[:-8] + b"more"), tmp_path / "b.mcap")
    assert (report.closed, report.lost_bytes, report.chunks) == (False, 4, 10) and "lost: the summary" in report.text


def test_a_message_of_an_undeclared_channel_is_lost_and_counted(tmp_path: Path) -> None:
    with open(tmp_path / "foreign.mcap", "wb") as file:
        writer = McapWriter(file, profile="", library="")
        named = writer.register_channel("/clock", "json", writer.register_schema("Clock", "jsonschema", b"{}"))
        for channel in (named, named + 7, named):
            writer.messages_of(channel)(0, b"{}")
        writer.finish()
    report = recover(tmp_path / "foreign.mcap", tmp_path / "b.mcap")
    assert (report.messages, report.lost_messages) == (2, 1)


def test_a_damaged_chunk_costs_only_itself(log: bytes, tmp_path: Path) -> None:
    data = bytearray(log)
    at = offsets(log, Opcode.CHUNK)[3]
    data[at + 200] ^= 0xFF
    source = written(tmp_path / "a.mcap", bytes(data))
    with pytest.raises(HilError, match=rf"chunk at byte {at}: .*hil recover"):
        read_run(source)
    report = recover(source, tmp_path / "b.mcap")
    assert states(read_run(tmp_path / "b.mcap")) == [k for k in range(200) if not 60 <= k < 80]
    assert report.lost_messages == 180 and report.closed
    assert any(loss.startswith(f"chunk at byte {at}") for loss in report.losses)


def test_a_damaged_first_chunk_does_not_cost_the_names_of_the_topics(log: bytes, tmp_path: Path) -> None:
    data = bytearray(log)
    data[offsets(log, Opcode.CHUNK)[0] + 300] ^= 0xFF
    recover(written(tmp_path / "a.mcap", bytes(data)), tmp_path / "b.mcap")
    assert states(read_run(tmp_path / "b.mcap")) == list(range(20, 200))


def test_a_damaged_attachment_is_reported_and_left_out(log: bytes, tmp_path: Path) -> None:
    data = log.replace(b"# demo\n", b"# demo!", 1)
    source = written(tmp_path / "a.mcap", data)
    with pytest.raises(HilError, match=r"attachment at byte .*checksum"):
        read_run(source)
    report = recover(source, tmp_path / "b.mcap")
    run = read_run(tmp_path / "b.mcap")
    assert run.experiment_text == "" and len(states(run)) == 200
    assert report.attachments == 2 and len(report.losses) == 1


def test_every_truncation_is_refused_clearly_and_recovered_as_far_as_possible(log: bytes, tmp_path: Path) -> None:
    rng = random.Random(1)
    frames = [r.offset for r in walk(BytesIO(log), len(log))]
    cuts = sorted(
        {*frames[:9], *frames[9::11], *(o + 1 for o in frames[::17]), *rng.sample(range(8, len(log)), 20), len(log) - 1}
    )
    chunks = offsets(log, Opcode.CHUNK)
    ends = [next(o for o in [*frames, len(log)] if o > at) for at in chunks]
    for cut in cuts:
        source = written(tmp_path / "a.mcap", log[:cut])
        with pytest.raises(HilError, match=r"a\.mcap: torn at byte \d+: .*hil recover"):
            read_run(source)
        target = tmp_path / "b.mcap"
        try:
            report = recover(source, target)
        except HilError as error:
            assert cut < frames[1], error  # not even the header is whole
            continue
        assert report.chunks == sum(end <= cut for end in ends)
        if report.chunks:
            assert len(states(read_run(target))) == 20 * report.chunks
        target.unlink()


def test_damage_anywhere_gives_an_error_or_a_run_and_never_a_traceback(log: bytes, tmp_path: Path) -> None:
    rng = random.Random(2)
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for _ in range(60):
        data = bytearray(log)
        for _ in range(rng.choice((1, 1, 3, 30))):
            at = rng.randrange(len(data))
            data[at : at + rng.choice((1, 1, 8))] = rng.randbytes(rng.choice((1, 1, 8, 0)))
        source.write_bytes(data)
        for whole in (True, False):
            try:
                read_run(source, whole=whole)
            except HilError as error:
                assert str(source) in str(error)
        try:
            recover(source, target)
        except HilError as error:
            assert str(source) in str(error)
        else:
            target.unlink()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty"),
        (b"ABCDEFGHIJKL", r"is no MCAP file: byte 0 begins b'ABCDEFGH'"),
        (MAGIC[:5], "is no MCAP file"),
        (MAGIC, "torn at byte 8: the log was never closed"),
        (MAGIC + MAGIC, "torn at byte 16: the log was never closed"),
        (MAGIC + b"\x01" + b"\xff" * 8, "torn at byte 8: a record of 18446744073709551615 bytes"),
        (bytes(1000), "is no MCAP file"),
    ],
)
def test_what_is_no_log_is_named(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(HilError, match=message):
        read_run(written(tmp_path / "a.mcap", data))


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # a reader that waits for its writer would hang here
    for path, says in ((tmp_path / "absent.mcap", "cannot be read: "), (tmp_path, "is a folder, not an MCAP log"),
                       (tmp_path / "pipe", "is no regular file")):  # fmt: skip
        with pytest.raises(HilError, match=f"{path}: {says}"):
            read_run(path)


def test_recovery_never_overwrites(log: bytes, tmp_path: Path) -> None:
    source = written(tmp_path / "a.mcap", log[:-100])
    for target in (source, written(tmp_path / "b.mcap", b"precious")):
        before = target.read_bytes()
        with pytest.raises(HilError, match="exists already; name another"):
            recover(source, target)
        assert target.read_bytes() == before


def test_recovery_onto_a_full_disk_leaves_nothing_behind(log: bytes, tmp_path: Path) -> None:
    source = written(tmp_path / "a.mcap", log[:-100])
    with files_up_to(len(log) // 2), pytest.raises(HilError, match=r"b\.mcap: cannot be written: File too large"):
        recover(source, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_a_log_that_filled_the_disk_keeps_what_the_sink_had_counted(tmp_path: Path) -> None:
    with files_up_to(40_000):
        sink = record_chunks(tmp_path / "a.mcap", 60)
    assert sink.error is not None
    record_chunks(tmp_path / "full.mcap", 60)
    report = recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert (report.messages, report.lost_bytes) == (sink.messages, 0)
    assert 0 < report.chunks < 60
    full, saved = read_run(tmp_path / "full.mcap"), read_run(tmp_path / "b.mcap")
    slots = {topic: array[array["slot"] < 20 * report.chunks] for topic, array in full.arrays.items()}
    assert_same_arrays(saved.arrays, slots)
    assert_same_arrays(read_run(tmp_path / "a.mcap", whole=False).arrays, slots)


_SESSION = """
import sys, time
from hil.log.write.mcap_sink import McapSink
from tests.file_limit import files_up_to
from tests.hil.log.recording import TABLE, provenance
sink = McapSink(sys.argv[1], TABLE, provenance(), now=time.monotonic)
put, pack = sink.channel("/reference"), TABLE["/reference"].schema.pack
begin, slot = time.monotonic_ns(), 0
while True:
    t_ns = time.monotonic_ns() - begin
    put(t_ns, pack(1.0, slot))
    sink.commit()
    print(t_ns, flush=True)
    slot += 1
    time.sleep(0.001)
"""


def test_a_killed_session_loses_its_last_100_ms_at_most(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    session = subprocess.Popen([sys.executable, "-c", _SESSION, str(path)], stdout=subprocess.PIPE, text=True, env=environment)
    assert session.stdout is not None
    reported = 0
    while reported < 400_000_000:
        reported = int(session.stdout.readline())
    session.send_signal(signal.SIGKILL)
    reported = max([reported, *(int(line) for line in session.communicate(timeout=LIMIT_S)[0].splitlines()[:-1])])
    assert session.returncode == -signal.SIGKILL
    report = recover(path, tmp_path / "b.mcap")
    assert reported - report.last_ns < 100_000_000
    run = read_run(tmp_path / "b.mcap")
    assert list(run.arrays["/reference"]["slot"]) == list(range(report.messages))
    assert run.experiment_text == provenance().experiment_text


def test_the_command_says_what_was_kept_and_what_was_lost(log: bytes, tmp_path: Path) -> None:
    source = written(tmp_path / "run.mcap", log[: offsets(log, Opcode.CHUNK)[5]])
    done = CliRunner().invoke(command, [str(source)], catch_exceptions=False)
    assert done.exit_code == 0
    kept = "kept: 901 messages in 5 chunks, up to 0.099 s of session time; 3 metadata records, 3 attachments"
    assert kept in " ".join(done.output.split())
    assert "lost: the summary" in done.output
    assert f"written: {tmp_path / 'run.recovered.mcap'}" in done.output
    assert len(states(read_run(tmp_path / "run.recovered.mcap"))) == 100
