"""The MCAP file: readable by others, the same for the same records, where it comes from, and no danger to the session."""

from __future__ import annotations

import os
import stat
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader

import hil
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log import decode_event
from hil.log.read import Run, read_run
from hil.log.topics import channels_of
from hil.log.write import MemorySink, TeeSink, pipe_sink, record_to, records_to
from hil.log.write.mcap_sink import McapSink
from hil.log.write.mcap_writer import Compressor
from hil.log.write.provenance import Provenance, commit, loop_form
from hil.runtime.virtual import run_virtual
from tests.bench.plain_log import PlainSink
from tests.file_limit import files_up_to
from tests.hil.log.recording import PERIOD_NS, TABLE, assert_same_arrays, provenance, record


def write(path: Path, slots: int = 500) -> tuple[McapSink, MemorySink]:
    memory = MemorySink(TABLE)
    with McapSink(path, TABLE, provenance()) as sink:
        record(TeeSink(sink, {topic: put for topic in memory.times if (put := memory.channel(topic))}), slots)
        sink.summary({"metrics": {"sse": 1.5}})
    return sink, memory


def test_a_run_reads_back_as_it_was_written(tmp_path: Path) -> None:
    sink, memory = write(tmp_path / "run.mcap")
    run, same = read_run(tmp_path / "run.mcap"), Run.from_memory(memory)
    assert list(run.arrays) == list(TABLE)
    assert_same_arrays(run.arrays, same.arrays)
    assert run.events == same.events
    assert [event["data"]["u"] for event in run.events] == ["nan"] * 5
    assert sink.messages == sum(map(len, run.arrays.values())) + len(run.events)
    assert sink.dropped == 0 and sink.error is None
    state = run.arrays["/plant/state"]
    assert state.dtype.names == ("t_ns", "angle", "speed", "slot")
    np.testing.assert_array_equal(state["t_ns"], state["slot"] * PERIOD_NS)
    assert all(len(data) == 20 for data in run.arrays["/link/sensor"]["data"])


def test_provenance_travels_inside(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap")
    run = read_run(tmp_path / "run.mcap")
    assert run.experiment_text == provenance().experiment_text
    assert run.resolved == {"period": 0.001, "limits": {"voltage": 24.0}}
    assert run.certificate == {"state": "certified", "reason": "radius below 1", "radius": 0.9}
    own = {"commit": commit()} if commit() else {}  # an installed package has none
    own |= {"loop": loop_form()}
    assert run.metadata == own | {"format": "3", "experiment": "demo", "seed": "7", "clock": "virtual", "link": "memory:"}
    assert run.versions["numpy"] == np.__version__
    assert run.codes["reason"] == ["delivered", "lost"]
    assert run.summary["metrics"] == {"sse": 1.5}
    assert run.summary["log"]["dropped"] == 0


def test_in_real_time_records_are_on_the_disk_within_100_ms(tmp_path: Path) -> None:
    now = 0.0
    sink = McapSink(tmp_path / "run.mcap", TABLE, provenance(), now=lambda: now)
    size = (tmp_path / "run.mcap").stat().st_size
    record(sink, 1)
    assert (tmp_path / "run.mcap").stat().st_size == size
    now = 0.06
    sink.commit()
    assert (tmp_path / "run.mcap").stat().st_size > size
    sink.close()


def test_closing_twice_is_harmless_and_later_records_are_counted(tmp_path: Path) -> None:
    sink, _ = write(tmp_path / "run.mcap", slots=10)
    written = (tmp_path / "run.mcap").read_bytes()
    sink.close()
    sink.event(0, "late", "after the end")
    sink.commit()
    assert sink.dropped == 1
    assert (tmp_path / "run.mcap").read_bytes() == written


@pytest.mark.parametrize("name", ["absent/run.mcap", ".", "file/run.mcap", "x" * 300])
def test_a_place_that_cannot_be_written_is_refused_at_open(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("not a directory")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(HilError, match=r"log .*: cannot be created: "):
        McapSink(tmp_path / name, TABLE, provenance())
    assert sorted(tmp_path.rglob("*")) == before


def test_a_full_device_is_refused_at_open() -> None:
    with pytest.raises(HilError, match=r"log /dev/full: cannot be written: No space left"):
        McapSink("/dev/full", TABLE, provenance())
    assert os.path.exists("/dev/full")


def test_a_log_is_discarded_and_a_device_stays(tmp_path: Path) -> None:
    device, file = tmp_path / "null", tmp_path / "run.mcap"
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 3))  # not that of the machine
    except PermissionError:
        pytest.skip("needs to make a device: CAP_MKNOD")
    for path in (device, file):
        McapSink(path, TABLE, provenance()).discard()
    assert device.is_char_device() and not file.exists()


def test_a_disk_that_fills_up_stops_the_log_and_not_the_session(tmp_path: Path) -> None:
    now = 0.0
    sink = McapSink(tmp_path / "run.mcap", TABLE, provenance(), now=lambda: now)
    total = 0
    with files_up_to(60_000):  # writing beyond it fails in the middle
        for k in range(100):
            now = k * 0.06
            total += record(sink, 20, start=20 * k)
        sink.close()
    assert sink.error is not None and "run.mcap: File too large" in sink.error
    assert 0 < sink.messages < total
    assert sink.messages + sink.dropped == total


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda path: None, None), (lambda path: path.unlink(), "was removed during the run"),
        (lambda path: path.rename(path.with_suffix(".old")), "was renamed while the log was written"),
        (lambda path: (path.rename(path.with_suffix(".old")), path.write_text("")), "was replaced by another file while"),
    ],
    ids=["nothing", "removed", "renamed", "replaced"],
)  # fmt: skip
def test_what_became_of_the_name_of_a_log_is_said(tmp_path: Path, change: Callable[[Path], object], said: str | None) -> None:
    with McapSink(tmp_path / "run.mcap", TABLE, provenance()) as sink:
        change(tmp_path / "run.mcap")
        found = sink.gone()
    assert found is None if said is None else (found or "").startswith(said)


def test_no_file_is_left_when_the_first_bytes_do_not_fit(tmp_path: Path) -> None:
    with files_up_to(60_000), pytest.raises(HilError, match="cannot be written: File too large"):
        McapSink(tmp_path / "run.mcap", TABLE, provenance(experiment_text="x" * 70_000))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["dc-motor-hinf", "dc-motor-packets", "vtol-h2"])
def test_the_file_is_that_of_mcaps_own_writer_byte_for_byte(name: str, tmp_path: Path) -> None:
    loop = compose(load_experiment(name), certify=False)
    table = channels_of(loop)
    for sink in (PlainSink(tmp_path / "plain", table, provenance()), McapSink(tmp_path / "ours", table, provenance())):
        with sink:
            run_virtual(loop, 5, sink)
            sink.event(-5, "late", "before the first slot", x=1.5)
    assert (tmp_path / "ours").read_bytes() == (tmp_path / "plain").read_bytes()
    assert len((tmp_path / "ours").read_bytes()) > 100_000  # several chunks


def test_several_records_at_once_are_those_one_by_one_whatever_the_length_of_the_frame(tmp_path: Path) -> None:
    topics = ("/plant/state", "/link/sensor", "/plant/measurement")
    with McapSink(tmp_path / "at once", TABLE, provenance()) as at_once, McapSink(tmp_path / "one", TABLE, provenance()) as one:
        together, singly = records_to(at_once, topics), [record_to(one, TABLE[topic]) for topic in topics]
        assert together is not None
        for k in range(150):  # more lengths than layouts are kept
            frame = bytes([k]) * k
            together(k - 1, (0.1 * k, 2.0, k, k, 1, frame, 0.3, k))
            for log, values in zip(singly, ((0.1 * k, 2.0, k), (k, 1, frame), (0.3, k))):
                assert log is not None
                log(k - 1, values)
            at_once.event(k, "between", "two slots")
            one.event(k, "between", "two slots")
        with pytest.raises(TypeError, match="7 values, expected 8 in 3 records"):
            together(0, (0.1, 2.0, 1, 1, 1, b"", 0.3))
        assert at_once.messages + at_once.dropped == 0
    assert (tmp_path / "at once").read_bytes() == (tmp_path / "one").read_bytes()
    assert at_once.messages == 150 * 4
    together(0, (0.1, 2.0, 1, 1, 1, b"", 0.3, 1))  # the file is closed: all three are counted
    assert at_once.dropped == 3
    with pytest.raises(ValueError, match="records: 2 carry frames, expected one at most"):
        at_once.records(("/link/sensor", "/link/control"))
    assert at_once.records(("/link/sensor", "/of/no_node")) is None


def test_a_file_without_records_is_that_of_mcaps_own_writer(tmp_path: Path) -> None:
    for sink in (PlainSink(tmp_path / "plain", TABLE, provenance()), McapSink(tmp_path / "ours", TABLE, provenance())):
        sink.__exit__(None, None, None)
    assert (tmp_path / "ours").read_bytes() == (tmp_path / "plain").read_bytes()


def test_what_is_kept_is_what_the_file_says(tmp_path: Path) -> None:
    keep = {"/plant/state": None, "/network/sc": ("mode", "reason"), "/timing/slot": None}
    with McapSink(tmp_path / "run.mcap", TABLE, provenance(), keep=keep) as sink:
        record(sink, 3000)
    arrays, run = sink.kept.arrays(), read_run(tmp_path / "run.mcap")
    assert list(arrays) == list(keep)
    for topic, array in arrays.items():
        assert len(array) == len(run.arrays[topic])
        for field in array.dtype.names:
            np.testing.assert_array_equal(array[field], run.arrays[topic][field])
    assert arrays["/network/sc"].dtype.names == ("t_ns", "mode", "reason")
    assert [decode_event(payload) for payload in sink.kept.events()] == run.events
    with pytest.raises(ValueError, match="/link/sensor"):
        McapSink(tmp_path / "none.mcap", TABLE, provenance(), keep={"/link/sensor": None})


def test_a_log_without_message_index_is_half_as_long_and_mcaps_reader_finds_every_message(tmp_path: Path) -> None:
    found = {}
    for index in ("full", "chunk"):
        path = tmp_path / f"{index}.mcap"
        with McapSink(path, TABLE, provenance(), index=index) as sink:
            for start in range(0, 2000, 100):
                record(sink, 100, start=start)
                sink.commit()
        with open(path, "rb") as file:
            reader = make_reader(file)
            statistics = reader.get_summary().statistics
            messages = [(channel.topic, m.log_time, m.data) for _, channel, m in reader.iter_messages(log_time_order=False)]
            states = [m.log_time for _, _, m in reader.iter_messages(topics=["/plant/state"])]
        found[index] = statistics.channel_message_counts, messages, states, read_run(path).arrays["/plant/state"].tolist()
        assert statistics.message_count == len(messages)
    assert found["full"] == found["chunk"]
    assert os.path.getsize(tmp_path / "chunk.mcap") < 0.75 * os.path.getsize(tmp_path / "full.mcap")


ROOM = 1 << 15


def data(length: int) -> bytes:
    return np.random.default_rng(length).integers(0, 9, length, np.uint8).tobytes()


def memory(compressor: Compressor) -> int:
    return sum(context.memory_size() for context in compressor.contexts.values())


def test_memory_is_taken_once_whatever_comes() -> None:
    """A session grew by 0.9 MB where it was kept from its pipe for 0.1 s: the chunk after that was long."""
    ours, plain = Compressor(ROOM), zstandard.ZstdCompressor()
    taken, one = {memory(ours)}, set()
    lengths = np.random.default_rng(0).integers(1, ROOM, 400).tolist()
    for length in (*[ROOM // 40] * 300, ROOM, *lengths, 1, ROOM):
        ours.compress(data(length))
        plain.compress(data(length))
        taken.add(memory(ours))
        one.add(plain.memory_size())
    assert len(taken) == 1 < len(one)


def test_a_frame_is_what_one_context_makes_of_it() -> None:
    ours, plain = Compressor(ROOM), zstandard.ZstdCompressor()
    for length in (0, 1, 700, 1024, 1025, ROOM, 12, 5 * ROOM):
        assert ours.compress(data(length)) == plain.compress(data(length))


def git(folder: Path, *words: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
    done = subprocess.run(["git", "-C", str(folder), *identity, *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_a_checkout_is_named_by_its_commit_and_by_what_differs_from_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken/.git").mkdir(parents=True)
    assert commit(tmp_path) == commit(tmp_path / "broken") == "", "no checkout"
    git(tmp_path, "init", "-q")
    (tmp_path / "a").write_text("1")
    git(tmp_path, "add", "a")
    git(tmp_path, "commit", "-qm", "one")
    commit.cache_clear()
    clean = commit(tmp_path)
    assert len(clean) == 12 and git(tmp_path, "rev-parse", "HEAD").startswith(clean)
    (tmp_path / "a").write_text("2")
    commit.cache_clear()
    assert commit(tmp_path) == f"{clean}-dirty"
    commit.cache_clear()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert commit(tmp_path) == "", "no git"
    commit.cache_clear()


def test_without_a_commit_there_is_no_key() -> None:
    about = Provenance(experiment="x", experiment_text="", resolved={}, seed=0, clock="virtual", link="memory:", commit="")
    assert "commit" not in about.metadata()["hilrig"]


def test_a_run_logs_its_commit_and_stays_the_same_file() -> None:
    first, second = (hil.run("dc-motor-hinf", duration=1) for _ in range(2))
    assert first.run.metadata.get("commit", "") == commit()
    assert first.summary["log"]["sha256"] == second.summary["log"]["sha256"]


@pytest.mark.parametrize(("file", "form"), [("pipe_sink.py", "interpreted"), ("pipe_sink.cpython-311.so", "compiled")])
def test_a_log_says_whether_its_loop_was_compiled(file: str, form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert hil.run("dc-motor-hinf", duration=0.1).run.metadata["loop"] == loop_form()
    monkeypatch.setattr(pipe_sink, "__file__", f"/somewhere/{file}")
    about = Provenance(experiment="x", experiment_text="", resolved={}, seed=0, clock="virtual", link="memory:")
    assert loop_form() == about.metadata()["hilrig"]["loop"] == form
