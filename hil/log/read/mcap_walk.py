"""Walk through the bytes of an MCAP file, knowing at every step where one stands.

The records themselves are parsed by the ``mcap`` package. It does not tell the offset of what it cannot read, and a log
that cannot be read is of little use without it; so the framing (opcode, u64 length) is followed here.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import Final, NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Attachment, Chunk, McapRecord
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from hil.errors import HilError

MAGIC: Final = MCAP0_MAGIC
_FRAME: Final = struct.Struct("<BQ")
_MAX_CHUNK: Final = 1 << 30

R = TypeVar("R")


class Record(NamedTuple):
    """A framed record: where it begins in the file, its opcode and its body."""

    offset: int
    opcode: int
    body: memoryview


class DamagedRecord(HilError):
    """A record that is framed well and cannot be parsed; the walk may go on behind it."""


class TornFile(HilError):
    """The framing itself ends before the file's footer; nothing behind ``offset`` can be read."""

    def __init__(self, offset: int, reason: str) -> None:
        self.offset = offset
        super().__init__(f"torn at byte {offset}: {reason}")


def walk(data: bytes | memoryview, start: int = 0) -> Iterator[Record]:
    """Records of ``data`` from ``start`` on, until its end.

    Raises:
        TornFile: if a record is announced longer than what is left.
    """
    view = memoryview(data)
    end = len(view)
    at = start
    while at < end:
        if end - at < _FRAME.size:
            raise TornFile(at, f"{end - at} bytes are left, a record needs {_FRAME.size} at least")
        opcode, length = _FRAME.unpack_from(view, at)
        body = at + _FRAME.size
        if length > end - body:
            raise TornFile(at, f"a record of {length} bytes is announced, {end - body} are left")
        yield Record(at, opcode, view[body : body + length])
        at = body + length


def parse_attachment(record: Record) -> Attachment:
    """Parse an attachment, and check it against its CRC, which mcap's own reader leaves out.

    Raises:
        DamagedRecord: if it cannot be had whole.
    """
    attachment: Attachment = parse(Attachment.read, record)
    crc = int.from_bytes(record.body[-4:], "little")
    if crc and zlib.crc32(record.body[:-4]) != crc:
        raise DamagedRecord(f"attachment at byte {record.offset}: the checksum does not match")
    return attachment


def chunk_records(record: Record) -> list[McapRecord]:
    """Schemas, channels and messages of a chunk, in its order.

    Raises:
        DamagedRecord: if one of them cannot be read.
    """
    content = unpack_chunk(record)
    plain = Chunk(
        compression="", data=content, message_start_time=0, message_end_time=0, uncompressed_crc=0,
        uncompressed_size=len(content),
    )  # fmt: skip
    return _guarded(lambda: breakup_chunk(plain), record)


def parse(read: Callable[[ReadDataStream], R], record: Record) -> R:
    """Parse a record by one of mcap's own readers.

    Raises:
        DamagedRecord: whatever goes wrong, with the record's offset.
    """
    return _guarded(lambda: read(ReadDataStream(BytesIO(record.body))), record)


def unpack_chunk(record: Record) -> bytes:
    """Content of a chunk, uncompressed and checked against its CRC.

    Raises:
        DamagedRecord: if it cannot be had whole.
    """
    chunk = parse(Chunk.read, record)
    where = f"chunk at byte {record.offset}"
    if chunk.uncompressed_size > _MAX_CHUNK:
        raise DamagedRecord(f"{where}: announces {chunk.uncompressed_size} bytes")
    try:
        if chunk.compression == "zstd":
            content = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
        elif chunk.compression == "":
            content = chunk.data
        else:
            raise DamagedRecord(f"{where}: compression {chunk.compression!r} is not supported, expected zstd or none")
    except (zstandard.ZstdError, MemoryError) as error:
        raise DamagedRecord(f"{where}: {error}") from error
    if len(content) != chunk.uncompressed_size:
        raise DamagedRecord(f"{where}: holds {len(content)} bytes, announces {chunk.uncompressed_size}")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise DamagedRecord(f"{where}: the checksum does not match")
    return content


def _guarded(read: Callable[[], R], record: Record) -> R:
    try:
        return read()
    except (McapError, struct.error, ValueError, KeyError, TypeError, OverflowError, MemoryError) as error:
        raise DamagedRecord(f"damaged record at byte {record.offset}: {str(error) or type(error).__name__}") from error
