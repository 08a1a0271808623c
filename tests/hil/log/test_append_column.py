"""Arrays that grow in a file: the same rows, whatever the disk refused, and no more memory for a longer run."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path
from struct import pack

import numpy as np
import pytest
from mcap.reader import make_reader

from hil.log import append_column
from hil.log.append_column import IN_MEMORY, ROWS, AppendColumn, pieces, release, whole
from hil.log.read import read_run
from hil.log.read.mcap_file import Columns
from hil.log.records import Field, Schema
from hil.log.write import mcap_sink, mcap_writer
from hil.log.write.mcap_sink import McapSink
from tests.hil.log.recording import PERIOD_NS, TABLE, provenance

ROW = np.dtype([("t_ns", "<i8"), ("value", "<f8"), ("late", "u1")])


def rows(n: int, seed: int = 0) -> np.ndarray:
    found = np.zeros(n, ROW)
    found["t_ns"], found["value"] = np.arange(n), np.random.default_rng(seed).standard_normal(n)
    return found


@pytest.mark.parametrize("n", [0, 1, 5_000, 2 * IN_MEMORY // ROW.itemsize + 17])
def test_what_was_added_is_what_is_there(n: int, tmp_path) -> None:
    expected, column = rows(n), AppendColumn(ROW, tmp_path)
    for start in range(0, n, 999):
        column.extend(expected[start : start + 999])
    assert len(column) == n
    array = column.array()
    del column  # the file is held by what is mapped
    assert array.dtype == ROW and array.tobytes() == expected.tobytes()
    release(array)
    assert np.concatenate([np.empty(0, ROW), *pieces(array, 1000)]).tobytes() == expected.tobytes()
    assert whole(array, "value").tobytes() == expected["value"].tobytes()
    assert not list(tmp_path.iterdir())


def test_a_long_array_is_no_memory_of_ours(tmp_path) -> None:
    column = AppendColumn(ROW, tmp_path)
    for seed in range(2 * IN_MEMORY // (1000 * ROW.itemsize)):
        column.extend(rows(1000, seed))
    array = column.array()
    assert not array.flags.owndata and not array.flags.writeable


def test_what_waits_for_the_file_is_little_from_the_beginning(tmp_path) -> None:
    """Each column waited for its first two megabytes, and grew until then."""
    column, most = AppendColumn(ROW, tmp_path), 0
    parts = [rows(300, seed) for seed in range(200)]
    tracemalloc.start()
    try:
        for part in parts:
            column.extend(part.copy())
            most = max(most, tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert most < 2 * append_column.PENDING and len(column) * ROW.itemsize > 8 * append_column.PENDING
    array = column.array()
    assert array.flags.writeable  # a short one is the caller's own
    assert array.tobytes() == np.concatenate(parts).tobytes()


def test_a_full_disk_costs_memory_and_not_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    expected, column = rows(3 * IN_MEMORY // ROW.itemsize), AppendColumn(ROW)
    write, room = os.pwrite, [2]

    def pwrite(*arguments) -> int:
        room[0] -= 1
        if room[0] < 0:
            raise OSError(28, "No space left on device")
        return write(*arguments)

    monkeypatch.setattr(append_column.os, "pwrite", pwrite)
    for start in range(0, len(expected), 5000):
        column.extend(expected[start : start + 5000])
    assert room[0] < 0
    assert column.array().tobytes() == expected.tobytes()


def test_a_folder_that_cannot_be_written_is_not_needed(tmp_path) -> None:
    column = AppendColumn(ROW, tmp_path / "gone")
    for _ in range(2):
        column.extend(rows(IN_MEMORY // ROW.itemsize + 1))
    assert len(column.array()) == 2 * (IN_MEMORY // ROW.itemsize + 1)


FEW, MANY = 2_000, 8_000
BYTES_PER_SLOT = 6.0
"""A state kept as a number has 8; a chunk's place in the summary costs 1 to 2 per slot while it is below `IN_MEMORY`."""


@pytest.fixture
def short_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(append_column, "IN_MEMORY", 1 << 12)
    monkeypatch.setattr(append_column, "PENDING", 1 << 12)


def write(path: Path, slots: int) -> float:
    """Write so many slots; return how many bytes every slot of the last part took."""
    with McapSink(path, TABLE, provenance(), keep={"/plant/state": None}) as sink:
        state, frame = sink.records(("/plant/state",)), sink.records(("/link/sensor",))
        assert state is not None and frame is not None
        held = []
        for k in range(slots):
            state(k * PERIOD_NS, (0.1 * k, 1.0, k))
            frame(k * PERIOD_NS, (k, 0, bytes(40)))
            sink.commit()
            if k in (FEW - 1, MANY - 1) and tracemalloc.is_tracing():
                held.append(tracemalloc.get_traced_memory()[0])
        arrays = sink.kept.arrays()
    return (held[-1] - held[0]) / (MANY - FEW) if held else float(len(arrays))


@pytest.mark.usefixtures("short_arrays")
def test_writing_holds_no_more_for_a_longer_run(tmp_path: Path) -> None:
    tracemalloc.start()
    try:
        assert write(tmp_path / "run.mcap", MANY) < BYTES_PER_SLOT
    finally:
        tracemalloc.stop()


@pytest.mark.usefixtures("short_arrays")
def test_a_chunk_that_is_written_leaves_no_memory_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In real time a chunk ends every 50 ms: at 350 bytes each a session grew by 0.5 MB a minute."""
    monkeypatch.setattr(mcap_sink, "FLUSH_BYTES", 1)  # a chunk per slot
    monkeypatch.setattr(append_column, "IN_MEMORY", 2 << 20)
    monkeypatch.setattr(mcap_writer, "INDEX_WAITING", 1 << 13)
    sink, held, few, many = McapSink(tmp_path / "run.mcap", TABLE, provenance()), {}, 500, 1_500
    state, pack = sink.channel("/plant/state"), TABLE["/plant/state"].schema.pack
    assert state is not None
    tracemalloc.start()
    try:
        for k in range(many):
            state(k * PERIOD_NS, pack(0.1, 1.0, k))
            sink.commit()
            if k in (few, many - 1):
                held[k] = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
        sink.close()
    assert held[many - 1] - held[few] < 100 * (many - few)
    assert len(read_run(tmp_path / "run.mcap").numbers("/plant/state")) == many


@pytest.mark.usefixtures("short_arrays")
def test_closing_holds_no_index_of_a_long_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_sink, "FLUSH_BYTES", 1)  # a chunk per slot
    monkeypatch.setattr(mcap_sink, "MOST_WAITING", 1 << 14)
    monkeypatch.setattr(mcap_writer, "INDEX_PIECE", 1 << 12)
    sink, chunks = McapSink(tmp_path / "run.mcap", TABLE, provenance(), index="chunk"), 3_000
    state, pack = sink.channel("/plant/state"), TABLE["/plant/state"].schema.pack
    assert state is not None
    for k in range(chunks):
        state(k * PERIOD_NS, pack(0.1, 1.0, k))
        sink.commit()
    tracemalloc.start()
    try:
        sink.close()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 40 * chunks  # the index has some 90 bytes for every chunk
    with open(tmp_path / "run.mcap", "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and len(summary.chunk_indexes) == chunks
    assert len(read_run(tmp_path / "run.mcap").numbers("/plant/state")) == chunks


@pytest.mark.usefixtures("short_arrays")
def test_reading_holds_no_more_for_a_longer_log(tmp_path: Path) -> None:
    held = []
    for slots in (FEW, MANY):
        write(tmp_path / f"{slots}.mcap", slots)
        tracemalloc.start()
        run = read_run(tmp_path / f"{slots}.mcap")
        frames = sum(len(piece) for piece in run.pieces("/link/sensor", 512))
        held.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
        assert frames == len(run.numbers("/plant/state")) == slots
    assert (held[1] - held[0]) / (MANY - FEW) < BYTES_PER_SLOT


RAW = Schema(name="hil/msg/Demo", fields=(Field(type="int64", name="number"), Field(type="uint8[]", name="data")))


@pytest.mark.parametrize("count", [0, 1, ROWS, ROWS + 1])
def test_all_records_stand_in_one_array_however_many_pieces_they_fill(count: int) -> None:
    columns = Columns("/raw", RAW, start_ns=5)
    columns.add([bytes(15) + pack("<q", n) + bytes(8) + RAW.pack(n, b"ab"[: n % 3]) for n in range(count)])
    columns.finish()
    found = columns.array()
    assert found["number"].tolist() == [*range(count)] and found["data"].tolist() == [b"ab"[: n % 3] for n in range(count)]
    assert found["t_ns"].tolist() == [n - 5 for n in range(count)]
