"""Memory that does not grow with the run: what Python holds per slot, while a log is written and while it is read."""

import tracemalloc
from pathlib import Path

import pytest
from mcap.reader import make_reader

from hil.log import append_column
from hil.log.read.run import read_run
from hil.log.write import mcap_sink, mcap_writer
from hil.log.write.mcap_sink import McapSink
from tests.hil.log.recording import PERIOD_NS, TABLE, provenance

FEW, MANY = 2_000, 8_000
BYTES_PER_SLOT = 6.0
"""A state kept as a number has 8; a chunk's place in the summary costs 1 to 2 per slot while it is below `IN_MEMORY`."""


@pytest.fixture(autouse=True)
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


def test_writing_holds_no_more_for_a_longer_run(tmp_path: Path) -> None:
    tracemalloc.start()
    try:
        assert write(tmp_path / "run.mcap", MANY) < BYTES_PER_SLOT
    finally:
        tracemalloc.stop()


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
