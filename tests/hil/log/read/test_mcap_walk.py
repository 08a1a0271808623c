"""An MCAP file record by record: what is whole is given, and what is torn, damaged or too large says so, at its edges."""

from __future__ import annotations

import io
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
from hil.log import encode_event
from hil.log.read import mcap_walk, read_run
from hil.log.read.mcap_walk import (
    LARGEST_RECORD,
    MAGIC,
    MESSAGE_PAYLOAD_AT,
    Budget,
    Checksums,
    DamagedRecord,
    Record,
    TooLarge,
    TornFile,
    framed,
    parse_attachment,
    unpack_chunk,
    walk,
)
from hil.log.read.recover import recover
from tests.hil.log.recording import record_chunks


def raw(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def record(opcode: int, body: bytes, at: int = 77) -> Record:
    return Record(at, opcode, memoryview(body))


def walked(data: bytes, size: int | None = None) -> list[tuple[int, int, bytes]]:
    return [(each.offset, each.opcode, bytes(each.body)) for each in walk(io.BytesIO(data), len(data) if size is None else size)]


TWO = MAGIC + raw(3, b"abc") + raw(4, b"")


@pytest.mark.parametrize("end", [b"", MAGIC], ids=["open", "closed"])
def test_records_are_given_up_to_the_closing_magic_or_the_end(end: bytes) -> None:
    assert walked(TWO + end) == [(8, 3, b"abc"), (20, 4, b"")]
    assert walked(MAGIC) == walked(MAGIC + MAGIC) == []


@pytest.mark.parametrize(
    ("data", "at", "said"),
    [
        (TWO + bytes(8), 29, "8 bytes are left, a record needs 9 at least"),
        (TWO + bytes(9), 29, "zeros stand where a record should begin"),
        (TWO + raw(5, b"12345")[:-1], 29, "a record of 5 bytes is announced, 4 are left"),
        (TWO + struct.pack("<BQ", 5, 1 << 63), 29, "0 are left"),
    ],
    ids=["8 bytes", "zeros", "cut", "2^63 bytes"],
)
def test_a_file_that_is_cut_gives_what_is_whole_and_says_where_it_is_torn(data: bytes, at: int, said: str) -> None:
    found = []
    with pytest.raises(TornFile, match=f"^torn at byte {at}: .*{said}$") as torn:
        for each in walk(io.BytesIO(data), len(data)):
            found.append(each.offset)
    assert found == [8, 20] and torn.value.offset == at


def test_a_record_is_as_long_as_any_that_is_written_and_there_when_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TornFile, match=r"^torn at byte 8: a record of 3 bytes is announced, the file was cut"):
        walked((MAGIC + raw(3, b"abc"))[:-1], size=len(MAGIC + raw(3, b"abc")))
    monkeypatch.setattr(mcap_walk, "LARGEST_RECORD", 3)
    assert len(walked(TWO)) == 2
    with pytest.raises(TornFile, match=r"^torn at byte 29: a record of 4 bytes is announced, hil reads 3 at most"):
        walked(TWO + raw(3, b"abcd"))


def checked(*records: bytes) -> None:
    sums = Checksums()
    for each in walk(io.BytesIO(MAGIC + b"".join(records)), len(MAGIC) + sum(map(len, records))):
        sums.take(each)


def footer(summary: bytes, crc: int | None = None) -> bytes:
    body = struct.pack("<QQ", 1, 2)
    right = zlib.crc32(summary + struct.pack("<BQ", Opcode.FOOTER, 20) + body)
    return raw(Opcode.FOOTER, body + struct.pack("<I", right if crc is None else crc))


def test_checksums_of_data_and_summary_hold_where_the_writer_computed_any() -> None:
    data, summary = raw(3, b"abc"), raw(4, b"summary")

    def end(crc: int) -> bytes:
        return raw(Opcode.DATA_END, struct.pack("<I", crc))

    right = zlib.crc32(MAGIC + data)
    checked(data, end(right), summary, footer(summary))
    checked(data, end(0), summary, footer(summary, 0))
    with pytest.raises(DamagedRecord, match="the data section that ends at byte 20: the checksum does not match"):
        checked(data, end(right ^ 1), summary, footer(summary))
    with pytest.raises(DamagedRecord, match=r"the summary that ends at byte \d+: the checksum does not match"):
        checked(data, end(right), summary, footer(b"other"))
    with pytest.raises(DamagedRecord, match="the record that ends the data is missing"):
        checked(data, summary, footer(summary))


def test_a_file_unpacks_to_so_many_times_its_length_and_no_byte_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_walk, "UNPACKED_FLOOR", 10)
    monkeypatch.setattr(mcap_walk, "UNPACKED_RATIO", 2)
    for size, limit in ((4, 10), (5, 10), (6, 12), (10**9, 2 * 10**9)):
        budget = Budget(size)
        budget.take(3, record(6, b""))
        budget.take(limit - 3, record(6, b""))
        with pytest.raises(TooLarge, match=f"record at byte 77: the file unpacks to more than {limit} bytes, 2 times"):
            budget.take(1, record(6, b""))


def test_an_attachment_is_as_its_checksum_says() -> None:
    text = struct.pack("<QQI", 1, 2, 4) + b"name" + struct.pack("<I", 3) + b"kin" + struct.pack("<Q", 2) + b"ab"
    for crc in (zlib.crc32(text), 0):
        found = parse_attachment(record(Opcode.ATTACHMENT, text + struct.pack("<I", crc)))
        assert (found.name, found.data) == ("name", b"ab")
    with pytest.raises(DamagedRecord, match="attachment at byte 77: the checksum does not match"):
        parse_attachment(record(Opcode.ATTACHMENT, text + struct.pack("<I", zlib.crc32(text) ^ 1)))


SHORTEST = bytes([7, 0]) + bytes(MESSAGE_PAYLOAD_AT - 11)


def test_records_of_a_chunk_lie_one_behind_the_other_and_fill_it() -> None:
    content = raw(Opcode.MESSAGE, SHORTEST) + raw(Opcode.MESSAGE, SHORTEST + b"payload") + raw(Opcode.CHANNEL, b"\x05\x00")
    first, second = MESSAGE_PAYLOAD_AT, 2 * MESSAGE_PAYLOAD_AT + 7
    assert [*framed(content, record(6, b""))] == [
        (Opcode.MESSAGE, 7, 0, first), (Opcode.MESSAGE, 7, first, second), (Opcode.CHANNEL, 5, second, second + 11)
    ]  # fmt: skip
    for broken, said in (
        (content + bytes(5), "ends within a record"), (content + bytes(11), "zeros stand where a record should begin"),
        (content[:-1], "ends within a record"), (raw(Opcode.MESSAGE, SHORTEST + b"payload")[:-1], "exceeds it"),
        (raw(Opcode.MESSAGE, SHORTEST[:-1]), f"a message of {len(SHORTEST) - 1} bytes is too short"),
    ):  # fmt: skip
        with pytest.raises(DamagedRecord, match=f"chunk at byte 77: .*{said}"):
            list(framed(broken, record(6, b"")))


def chunk(data: bytes, *, size: int, how: str = "", crc: int = 0) -> Record:
    head = struct.pack("<QQQI", 1, 2, size, crc) + struct.pack("<I", len(how)) + how.encode()
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(data)) + data)


def test_a_chunk_is_unpacked_to_what_it_announces(monkeypatch: pytest.MonkeyPatch) -> None:
    text = b"so many bytes" * 10
    packed, size, crc = zstandard.ZstdCompressor().compress(text), len(text), zlib.crc32(text)
    for each in (
        chunk(text, size=size), chunk(text, size=size, crc=crc), chunk(packed, size=size, how="zstd"),
        chunk(packed, size=size, how="zstd", crc=crc),
    ):  # fmt: skip
        assert unpack_chunk(each, Budget(1000)) == text
    monkeypatch.setattr(mcap_walk, "LARGEST_RECORD", size)
    for each, said in (
        (chunk(text, size=size + 1), f"announces {size + 1} bytes, hil unpacks {size} at most"),
        (chunk(text, size=size - 1), f"holds {size} bytes, announces {size - 1}"),
        (chunk(packed, size=size - 1, how="zstd"), f"holds more than the {size - 1} bytes that it announces"),
        (chunk(text, size=size, crc=crc ^ 1), "the checksum does not match"),
        (chunk(packed, size=size, how="zstd", crc=crc ^ 1), "the checksum does not match"),
        (chunk(text, size=size, how="lz4"), "compression 'lz4' is not supported"),
        (chunk(text, size=size, how="zstd"), "chunk at byte 77: "),
        (record(Opcode.CHUNK, b"short"), "damaged record at byte 77"),
    ):  # fmt: skip
        with pytest.raises(DamagedRecord, match=said):
            unpack_chunk(each, Budget(1000))
    shorter = zstandard.ZstdCompressor().compress(text[:-1])
    with pytest.raises(DamagedRecord, match=f"holds {size - 1} bytes, announces {size}"):
        unpack_chunk(chunk(shorter, size=size, how="zstd"), Budget(1000))
    monkeypatch.setattr(mcap_walk, "UNPACKED_FLOOR", size - 1)
    with pytest.raises(TooLarge):
        unpack_chunk(chunk(text, size=size), Budget(0))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    record_chunks(path, 3)
    return path.read_bytes()


def zipped(content: bytes, *, announced: int | None = None) -> bytes:
    """A chunk as it stands in a file, and what it announces, if not its length."""
    size = len(content) if announced is None else announced
    return raw(Opcode.CHUNK, bytes(chunk(zstandard.compress(content), size=size, how="zstd", crc=zlib.crc32(content)).body))


def log_of(*records: bytes) -> bytes:
    header = raw(Opcode.HEADER, struct.pack("<I0sI0s", 0, b"", 0, b""))
    end = raw(Opcode.DATA_END, bytes(4)) + raw(Opcode.FOOTER, bytes(20))
    return MAGIC + header + b"".join(records) + end + MAGIC


PRIVATE = raw(0x80, bytes(200_000))
EVENTS = raw(Opcode.CHANNEL, struct.pack("<HHI7sI3sI", 1, 0, 7, b"/events", 3, b"cdr", 0))
EVENT = raw(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, 0, 0) + encode_event(0, "", "", data={}))

BOMBS = {
    "zeros": (lambda: log_of(zipped(bytes(LARGEST_RECORD))), "unpacks to more than|zeros stand"),
    "one large chunk": (lambda: log_of(zipped(bytes(2 * LARGEST_RECORD))), "hil unpacks 67108864 at most"),
    "a chunk that says less than it holds": (
        lambda: log_of(zipped(bytes(2 * LARGEST_RECORD), announced=1000)), "holds more than the 1000",
    ),
    "many chunks": (lambda: log_of(*[zipped(PRIVATE * 10)] * 30), "unpacks to more than"),
    "many events": (lambda: log_of(EVENTS, zipped(EVENT * 100_000)), "unpacks to more than"),
    "messages of no channel": (lambda: log_of(zipped(EVENT * 100_000)), "no record before them says what channel 1 is; save its"),
    "zeros in a small chunk": (lambda: log_of(zipped(bytes(9000))), "zeros stand where a record should begin"),
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_a_few_bytes_do_not_cost_gigabytes(tmp_path: Path, name: str) -> None:
    made, says = BOMBS[name]
    data = made()
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
        assert report.messages == (100_000 if name == "many events" else 0) and report.losses


def test_zeros_behind_the_log_are_no_records(tmp_path: Path, log: bytes) -> None:
    path = tmp_path / "sparse.mcap"
    path.write_bytes(log[:-8])
    with open(path, "r+b") as file:
        file.truncate(10**12)  # a walk of nine bytes a step would take a day
    with pytest.raises(HilError, match="zeros stand where a record should begin"):
        read_run(path)


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
