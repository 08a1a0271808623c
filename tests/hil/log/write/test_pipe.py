"""The pipe between loop and log: never waits, never tears a frame, counts what it loses."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.log.read import Run, read_run
from hil.log.records import Channel
from hil.log.write import MemorySink, PayloadWriter, record_to, records_to
from hil.log.write.mcap_sink import McapSink
from hil.log.write.pipe_sink import BLOCK_ID, FIRST_BLOCK_ID, HEAD, PipeSink
from hil.log.write.pump import PumpReport, pump
from tests.hil.log.recording import TABLE, assert_same_arrays, provenance, record
from tests.waiting import LIMIT_S

Ends = tuple[int, int]


@pytest.fixture
def ends() -> Iterator[Ends]:
    read, write = os.pipe()
    yield read, write
    for fd in (read, write):
        try:
            os.close(fd)
        except OSError:
            pass  # a sink has closed its end


def in_thread(read: int, sink: MemorySink) -> Callable[[], PumpReport]:
    reports: list[PumpReport] = []
    thread = threading.Thread(target=lambda: reports.append(pump(read, sink, TABLE)))
    thread.start()

    def join() -> PumpReport:
        thread.join(30)
        return reports[0]

    return join


def filled(write: int) -> int:
    """Fill the pipe to the last byte; returns how many bytes that took."""
    os.set_blocking(write, False)
    total = 0
    for size in (4096, 1):
        try:
            while True:
                total += os.write(write, bytes(size))
        except BlockingIOError:
            pass
    return total


def test_records_arrive_as_they_were_written(ends: Ends) -> None:
    got, direct = MemorySink(TABLE), MemorySink(TABLE)
    join = in_thread(ends[0], got)
    sink = PipeSink(ends[1], TABLE)
    count = record(sink, 300)
    sink.close()
    report = join()
    record(direct, 300)
    assert_same_arrays(Run.from_memory(got).arrays, Run.from_memory(direct).arrays)
    assert Run.from_memory(got).events == Run.from_memory(direct).events
    assert report == PumpReport(records=count, complete=True)
    assert sink.dropped == 0


def test_a_slot_is_one_write_of_at_most_pipe_buf_bytes(ends: Ends) -> None:
    sink = PipeSink(ends[1], TABLE)
    record(sink, 1)
    first = os.read(ends[0], 1 << 20)
    assert 0 < len(first) <= select.PIPE_BUF


@pytest.mark.parametrize(("period_ns", "together"), [(50_000_000, 1), (4_000_000, 2), (1_000_000, 8), (100_000, 8)])
def test_slots_of_eight_milliseconds_leave_together_and_at_once_with_an_event_and_at_the_end(
    ends: Ends, period_ns: int, together: int
) -> None:
    read, write = ends
    os.set_blocking(read, False)
    sink = PipeSink(write, TABLE, period_ns)
    put = sink.channel("/plant/state")
    assert put is not None

    def came(slots: int) -> int:
        for _ in range(slots):
            put(0, b"state")
            sink.commit()
        try:
            return os.read(read, 1 << 20).count(b"state")
        except BlockingIOError:
            return 0

    assert [came(1) for _ in range(16)] == [together * (k % together == together - 1) for k in range(16)]
    sink.event(0, "trip", "an event")
    assert came(1) == 1
    assert came(together - 1) == 0
    sink.close()
    assert os.read(read, 1 << 20).count(b"state") == together - 1


def test_a_full_pipe_costs_records_and_says_how_many(ends: Ends) -> None:
    read, write = ends
    sink = PipeSink(write, TABLE)
    filler = filled(write)
    lost = record(sink, 20)
    assert sink.dropped == lost
    while filler:
        filler -= len(os.read(read, min(filler, 1 << 16)))
    kept = record(sink, 5, start=20)
    sink.close()
    got = MemorySink(TABLE)
    report = pump(read, got, TABLE)
    run = Run.from_memory(got)
    assert (report.records, report.dropped, report.complete) == (kept, lost, True)
    assert list(run.arrays["/plant/state"]["slot"]) == [20, 21, 22, 23, 24]
    assert [(e["kind"], e["data"]) for e in run.events] == [("log-dropped", {"records": lost})]
    assert run.events[0]["t_s"] == 0.02


def test_several_records_at_once_are_those_one_by_one_whatever_the_length_of_the_frame(ends: Ends) -> None:
    topics = ("/plant/state", "/link/sensor", "/plant/measurement")
    read, write = ends
    sink = PipeSink(write, TABLE)
    together, singly = records_to(sink, topics), [record_to(sink, TABLE[topic]) for topic in topics]
    puts = [sink.channel(topic) for topic in topics]
    assert together is not None
    kept = in_thread(read, got := DatedMemory(TABLE))
    for k in range(150):  # more lengths than layouts are kept
        frame = bytes([k]) * k
        one_by_one = ((0.1 * k, 2.0, k), (k, 1, frame), (0.3, k))
        sink.behind(17 * k)
        together(k - 1, [value for values in one_by_one for value in values])
        for topic, log, put, values in zip(topics, singly, puts, one_by_one):
            assert log is not None and put is not None
            log(k - 1, values)
            put(k - 1, TABLE[topic].schema.pack(*values))
        sink.commit()
    sink.close()
    assert kept() == PumpReport(records=150 * 9, complete=True)
    for topic in topics:
        dated = list(zip(got.times[topic], got.behinds[topic], got.payloads[topic]))
        assert len(dated) == 450 and dated[::3] == dated[1::3] == dated[2::3]
        assert [behind for _, behind, _ in dated[::3]] == [17 * k for k in range(150)]


def test_records_that_cannot_stand_in_one_row_are_refused(ends: Ends) -> None:
    sink = PipeSink(ends[1], TABLE)
    together = sink.records(("/plant/state", "/link/sensor", "/plant/measurement"))
    assert together is not None
    with pytest.raises(TypeError, match="7 values, expected 8 in 3 records"):
        together(0, (0.1, 2.0, 1, 1, 1, b"", 0.3))
    with pytest.raises(ValueError, match="2 carry frames"):
        sink.records(("/link/sensor", "/link/control"))
    assert sink.records(("/link/sensor", "/of/no_node")) is None


class DatedMemory(MemorySink):
    """Keeps how much later each record happened, too."""

    def __init__(self, channels: dict[str, Channel]) -> None:
        super().__init__(channels)
        self.behinds: dict[str, list[int]] = {topic: [] for topic in channels}
        self._behind = 0

    def begin(self, wall_ns: int) -> None:
        """See `Dated`."""

    def behind(self, ns: int) -> None:
        self._behind = ns

    def channel(self, topic: str) -> PayloadWriter | None:
        put = super().channel(topic)
        if put is None or topic not in self.behinds:
            return put

        def dated(t_ns: int, payload: bytes) -> None:
            self.behinds[topic].append(self._behind)
            put(t_ns, payload)

        return dated


def test_records_packed_at_once_are_counted_one_by_one_when_the_pipe_is_full(ends: Ends) -> None:
    sink = PipeSink(ends[1], TABLE)
    together = sink.records(("/plant/measurement", "/reference"))
    assert together is not None
    filled(ends[1])
    for k in range(3):
        together(k, (0.1, k, 3.0, k))
        together(k, (0.2, k, 3.0, k))
        sink.commit()
    assert sink.dropped == 12


def test_where_the_pipe_has_no_room_to_declare_a_block_its_records_go_one_by_one(ends: Ends) -> None:
    sink = PipeSink(ends[1], TABLE)
    filled(ends[1])
    assert sink.records(("/plant/measurement", "/reference")) is None
    assert sink.records(("/reference",)) is not None
    assert sink.dropped == 0


@pytest.mark.parametrize(
    "declared",
    [(), (FIRST_BLOCK_ID,), (FIRST_BLOCK_ID, 999), (3, 1), (BLOCK_ID, 1), "two with frames"],
    ids=["of nothing", "of no channel", "unknown channel", "number of a channel", "number of ours", "two with frames"],
)
def test_a_block_that_cannot_be_is_counted_and_nothing_of_it_is_kept(ends: Ends, declared: tuple[int, ...] | str) -> None:
    read, write = ends
    if isinstance(declared, str):
        declared = (FIRST_BLOCK_ID, TABLE["/link/sensor"].id, TABLE["/link/control"].id)
    payload = b"".join(number.to_bytes(2, "little") for number in declared)
    os.write(write, HEAD.pack(len(payload), BLOCK_ID, 0, 0) + payload + HEAD.pack(4, FIRST_BLOCK_ID, 0, 0) + bytes(4))
    os.close(write)
    report = pump(read, got := MemorySink(TABLE), TABLE)
    assert report == PumpReport(malformed=2) and not any(got.payloads.values())


@pytest.mark.parametrize("off", [-1, 1])
def test_a_block_of_a_wrong_length_is_counted_and_not_kept(ends: Ends, off: int) -> None:
    read, write = ends
    channels = [TABLE["/plant/measurement"], TABLE["/reference"]]
    payload = b"".join(number.to_bytes(2, "little") for number in (FIRST_BLOCK_ID, *(channel.id for channel in channels)))
    os.write(write, HEAD.pack(len(payload), BLOCK_ID, 0, 0) + payload)
    size = sum(channel.schema.dtype.itemsize for channel in channels)
    for length in (size + off, size):
        os.write(write, HEAD.pack(length, FIRST_BLOCK_ID, 0, 0) + bytes(length))
    os.close(write)
    report = pump(read, got := MemorySink(TABLE), TABLE)
    assert report == PumpReport(records=2, malformed=1)
    assert [len(got.payloads[channel.topic]) for channel in channels] == [1, 1]


def test_a_pump_never_waits_at_the_pipe_where_every_write_would_wake_it(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    """It asks without waiting; what it waits for is time."""
    waits: list[tuple[int, float]] = []

    class Watched:
        def __init__(self) -> None:
            self.poll_, self.files = REAL_POLL(), 0

        def register(self, fd: int, events: int) -> None:
            self.files += 1
            self.poll_.register(fd, events)

        def poll(self, timeout_ms: float) -> list[tuple[int, int]]:
            waits.append((self.files, timeout_ms))
            return self.poll_.poll(timeout_ms)

    monkeypatch.setattr(select, "poll", Watched)
    stops = iter([False, False, True])
    pump(ends[0], MemorySink(TABLE), TABLE, stop=lambda: next(stops))
    assert {files for files, _ in waits} == {0, 1}
    assert all((timeout_ms == 0) == (files == 1) for files, timeout_ms in waits)


REAL_POLL = select.poll


def test_a_long_stall_of_the_reader_never_tears_a_frame(ends: Ends) -> None:
    read, write = ends
    sink = PipeSink(write, TABLE)
    total = record(sink, 3000)  # more than the pipe can hold
    assert 0 < sink.dropped < total
    got = MemorySink(TABLE)
    join = in_thread(read, got)
    total += record(sink, 10, start=3000)
    sink.close(timeout_s=10)
    report = join()
    assert report.complete and report.malformed == report.torn_bytes == 0
    assert report.dropped == sink.dropped
    assert report.records == total - sink.dropped


@given(st.lists(st.integers(0, 20_000), min_size=1, max_size=12), st.integers(1, 4))
def test_records_of_any_size_keep_the_framing(sizes: list[int], slots: int) -> None:
    read, write = os.pipe()
    sink = PipeSink(write, TABLE)
    put = sink.channel("/link/sensor")
    assert put is not None
    got = MemorySink(TABLE)
    pack = TABLE["/link/sensor"].schema.pack
    for slot in range(slots):
        for size in sizes:
            put(slot, pack(slot, 0, bytes(size)))
        sink.commit()
    sink.close()
    report = pump(read, got, TABLE)
    os.close(read)
    frames = Run.from_memory(got).arrays["/link/sensor"]
    assert report.torn_bytes == report.malformed == 0
    assert report.records + sink.dropped == len(sizes) * slots
    assert sink.dropped == report.dropped
    if not sink.dropped:
        assert [len(data) for data in frames["data"]] == sizes * slots


@pytest.mark.parametrize("at_once", [False, True], ids=["later", "at once"])
def test_a_record_cut_by_a_full_pipe_is_completed_by_the_next_slot(
    ends: Ends, at_once: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether the pipe has room again behind the slot, or within it, as soon as the record is cut."""
    read, write = ends
    write_some = os.write
    sink = PipeSink(write, TABLE)
    put = sink.channel("/link/sensor")
    assert put is not None
    filler = filled(write) - len(os.read(read, 8192))
    pack = TABLE["/link/sensor"].schema.pack

    def with_room(fd: int, data: bytes) -> int:
        nonlocal filler
        done = write_some(fd, data)
        while at_once and done < len(data) and filler:
            filler -= len(os.read(read, min(filler, 1 << 16)))
        return done

    monkeypatch.setattr(os, "write", with_room)
    put(0, pack(0, 0, b"x" * 30_000))
    put(0, pack(1, 0, b"dropped"))
    put(0, pack(1, 0, b"z" * 30_000))
    sink.commit()
    assert sink.dropped == 2
    while filler:
        filler -= len(os.read(read, min(filler, 1 << 16)))
    put(1, pack(2, 0, b"y"))
    sink.commit()
    sink.close()
    got = MemorySink(TABLE)
    report = pump(read, got, TABLE)
    assert report == PumpReport(records=2, dropped=2, complete=True)
    assert list(Run.from_memory(got).arrays["/link/sensor"]["data"]) == [b"x" * 30_000, b"y"]


def test_a_reader_that_is_gone_never_raises_into_the_loop(ends: Ends) -> None:
    read, write = ends
    sink = PipeSink(write, TABLE)
    os.close(read)
    count = record(sink, 10)
    sink.close()
    sink.close()
    assert sink.dropped == count
    assert sink.error == "log pipe: Broken pipe"


_RIG = """
import os, signal, sys
from hil.log.records import Channel
from hil.log.write.pipe_sink import BLOCK_ID, FIRST_BLOCK_ID, HEAD, PipeSink
from tests.hil.log.recording import TABLE, record
sink = PipeSink(int(sys.argv[1]), TABLE)
print(record(sink, 400), flush=True)
if sys.argv[2] == "torn":
    os.write(int(sys.argv[1]), bytes([200, 0, 0, 0, 1, 0, 7]))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize(("how", "torn"), [("whole", 0), ("torn", 7)])
def test_a_rig_that_is_killed_leaves_a_whole_log(ends: Ends, tmp_path: Path, how: str, torn: int) -> None:
    read, write = ends
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    rig = subprocess.Popen(
        [sys.executable, "-c", _RIG, str(write), how],
        pass_fds=[write], stdout=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    os.close(write)
    with McapSink(tmp_path / "run.mcap", TABLE, provenance()) as sink:
        report = pump(read, sink, TABLE)
    out, _ = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == -signal.SIGKILL
    assert report == PumpReport(records=int(out), torn_bytes=torn)
    run = read_run(tmp_path / "run.mcap")
    assert list(run.arrays["/plant/state"]["slot"]) == list(range(400))


@given(st.binary(max_size=400))
def test_any_bytes_in_the_pipe_are_taken_or_counted(garbage: bytes) -> None:
    read, write = os.pipe()
    os.write(write, garbage)
    os.close(write)
    got = MemorySink(TABLE)
    report = pump(read, got, TABLE)
    os.close(read)
    assert report.records == sum(map(len, got.payloads.values()))


def test_a_tap_sees_its_topic(ends: Ends) -> None:
    seen: list[int] = []
    sink = PipeSink(ends[1], TABLE)
    count = record(sink, 10)
    sink.close()
    got = MemorySink(TABLE, topics={"/reference"})
    report = pump(ends[0], got, TABLE, taps={"/plant/state": lambda t_ns, payload: seen.append(t_ns)})
    assert seen == [k * 1_000_000 for k in range(10)]
    assert report.records == count
    assert len(got.times["/reference"]) == 10


def test_the_pump_can_be_stopped_though_the_pipe_stays_open(ends: Ends) -> None:
    sink = PipeSink(ends[1], TABLE)
    count = record(sink, 10)
    report = pump(ends[0], MemorySink(TABLE), TABLE, stop=lambda: True)
    assert report == PumpReport(records=count)


def test_a_slot_above_pipe_buf_leaves_in_pieces_that_the_system_never_cuts(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    _, write = ends
    sizes: list[int] = []
    real = os.write

    def counting(fd: int, data: bytes) -> int:
        sizes.append(len(data))
        return real(fd, data)

    sink = PipeSink(write, TABLE)
    put = sink.channel("/events")
    assert put is not None
    for _ in range(5):
        put(0, bytes(1500))
    monkeypatch.setattr(os, "write", counting)
    sink.commit()
    assert len(sizes) > 1 and max(sizes) <= select.PIPE_BUF and sum(sizes) > 5 * 1500


def test_a_record_of_a_wrong_length_is_counted_and_not_kept(ends: Ends) -> None:
    read, write = ends
    memory = MemorySink(TABLE)
    join = in_thread(read, memory)
    sink = PipeSink(write, TABLE)
    put = sink.channel("/reference")
    assert put is not None
    record(sink, 3)
    put(0, b"short")
    sink.close()
    report = join()
    assert report.malformed == 1 and report.complete
    assert len(Run.from_memory(memory).arrays["/reference"]) == 3
