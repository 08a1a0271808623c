"""A log that is none: what costs more than its length accounts for is refused, and no flipped bit goes unsaid."""

from __future__ import annotations

import random
import struct
import tracemalloc
import zlib
from io import BytesIO
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode

from hil.errors import HilError
from hil.log.read.mcap_walk import LARGEST_RECORD, MAGIC, Budget, Record, TooLarge, walk
from hil.log.read.recover import recover
from hil.log.read.run import read_run
from tests.hil.log.recording import record_chunks


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    record_chunks(path, 3)
    return path.read_bytes()


def framed(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(content: bytes, *, announced: int | None = None) -> bytes:
    packed = zstandard.compress(content)
    size = len(content) if announced is None else announced
    head = struct.pack("<QQQI", 0, 0, size, zlib.crc32(content)) + struct.pack("<I4s", 4, b"zstd")
    return framed(Opcode.CHUNK, head + struct.pack("<Q", len(packed)) + packed)


def log_of(*records: bytes) -> bytes:
    header = framed(Opcode.HEADER, struct.pack("<I0sI0s", 0, b"", 0, b""))
    end = framed(Opcode.DATA_END, bytes(4)) + framed(Opcode.FOOTER, bytes(20))
    return MAGIC + header + b"".join(records) + end + MAGIC


MESSAGE = framed(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, 0, 0) + bytes(200_000))

BOMBS = {
    "zeros": (log_of(chunk(bytes(LARGEST_RECORD))), "unpacks to more than|zeros stand"),
    "one large chunk": (log_of(chunk(bytes(2 * LARGEST_RECORD))), "hil unpacks 67108864 at most"),
    "a chunk that says less than it holds": (
        log_of(chunk(bytes(2 * LARGEST_RECORD), announced=1000)), "holds more than the 1000",
    ),
    "many chunks": (log_of(*[chunk(MESSAGE * 10)] * 30), "unpacks to more than"),
    "zeros in a small chunk": (log_of(chunk(bytes(9000))), "zeros stand where a record should begin"),
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_a_few_bytes_do_not_cost_gigabytes(tmp_path: Path, name: str) -> None:
    data, says = BOMBS[name]
    path = tmp_path / "bomb.mcap"
    path.write_bytes(data)
    assert len(data) < 200_000
    tracemalloc.start()
    try:
        with pytest.raises(HilError, match=rf"bomb\.mcap: .*({says})"):
            read_run(path)
        assert tracemalloc.get_traced_memory()[1] < 100 << 20
    finally:
        tracemalloc.stop()
    try:
        report = recover(path, tmp_path / "out.mcap")
    except TooLarge:
        assert not (tmp_path / "out.mcap").exists()
    else:
        assert report.messages == 0 and report.losses


def test_zeros_behind_the_log_are_no_records(tmp_path: Path, log: bytes) -> None:
    path = tmp_path / "sparse.mcap"
    path.write_bytes(log[:-8])
    with open(path, "r+b") as file:
        file.truncate(10**12)  # a walk of nine bytes a step would take a day
    with pytest.raises(HilError, match="zeros stand where a record should begin"):
        read_run(path)


def test_the_limit_grows_with_the_file() -> None:
    record = Record(0, Opcode.CHUNK, memoryview(b""))
    Budget(10**9).take(10**10, record)
    budget = Budget(1000)
    budget.take(10**7, record)
    with pytest.raises(TooLarge, match="unpacks to more than 16777216 bytes"):
        budget.take(10**7, record)


def test_no_flipped_bit_is_read_without_a_word(tmp_path: Path, log: bytes) -> None:
    """Every bit of metadata, schemas, channels, attachments' heads, indexes and ends; every 97th byte elsewhere.

    No error rate: with one bit flipped a CRC-32 never matches.
    """
    chunks = [(r.offset, r.offset + len(r.body)) for r in walk(BytesIO(log), len(log)) if r.opcode == Opcode.CHUNK]
    places = [at for at in range(8, len(log)) if at % 97 == 0 or not any(a <= at < b for a, b in chunks)]
    rng = random.Random(3)
    path = tmp_path / "flip.mcap"
    for at in [*rng.sample(places, 250), *range(len(log) - 40, len(log))]:
        flipped = bytearray(log)
        flipped[at] ^= 1 << rng.randrange(8)
        path.write_bytes(flipped)
        with pytest.raises(HilError, match=r"flip\.mcap: "):
            read_run(path)


def test_recovery_says_that_a_flipped_schema_is_not_what_was_written(tmp_path: Path, log: bytes) -> None:
    path = tmp_path / "flip.mcap"
    path.write_bytes(log.replace(b"int64 slot", b"int64 pick"))
    report = recover(path, tmp_path / "out.mcap")
    assert "metadata, schemas or channels may be others than were written" in report.text
    path.write_bytes(log)
    assert "lost: nothing" in recover(path, tmp_path / "whole.mcap").text
    path.write_bytes(log[:-30])
    assert "unchecked: metadata, schemas and channels" in recover(path, tmp_path / "torn.mcap").text


def test_want_of_memory_is_not_called_a_torn_log(tmp_path: Path, log: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(log)

    def full(*_: object, **__: object) -> bytes:
        raise MemoryError

    monkeypatch.setattr("hil.log.read.mcap_walk.zlib.crc32", full)
    with pytest.raises(MemoryError):
        read_run(path)
