"""Walk through the bytes of an MCAP file, knowing at every step where one stands.

The records themselves are parsed by the ``mcap`` package. It does not tell the offset of what it cannot read, and a log
that cannot be read is of little use without it; so the framing (opcode, u64 length) is followed here.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import BinaryIO, Final, NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk

from hil.errors import HilError
from hil.log.write.mcap_records import MAGIC as MAGIC

_FRAME: Final = struct.Struct("<BQ")
_HEAD: Final = struct.Struct("<BQH")
MESSAGE_TIME_AT: Final = 15
MESSAGE_PAYLOAD_AT: Final = 31
LARGEST_RECORD: Final = 1 << 26
"""Bytes of a record, and of what a chunk unpacks to; the recorder's chunks have some 10^5."""

UNPACKED_FLOOR: Final = 1 << 24
UNPACKED_RATIO: Final = 40
"""How many times its own length, and how much at least, a file may unpack to. Logs unpack to some 3 times their length."""

R = TypeVar("R")


class Record(NamedTuple):
    """A framed record: where it begins in the file, its opcode and its body."""

    offset: int
    opcode: int
    body: memoryview


class DamagedRecord(HilError):
    """A record that is framed well and cannot be parsed; the walk may go on behind it."""


class TooLarge(HilError):
    """The file would cost more memory than its length accounts for."""


class TornFile(HilError):
    """The framing itself ends before the file's footer; nothing behind ``offset`` can be read."""

    def __init__(self, offset: int, reason: str) -> None:
        self.offset = offset
        super().__init__(f"torn at byte {offset}: {reason}")


def walk(file: BinaryIO, size: int) -> Iterator[Record]:
    """Records of a file from behind its magic on, up to its closing magic or, where there is none, to its end.

    One record is in memory at a time. Nothing is mapped, so that a file that is cut while it is read is a torn one.

    Args:
        file: open at any place.
        size: its length in bytes.

    Raises:
        TornFile: if a record is announced longer than what is left or than any that is written, or none begins there.
    """
    file.seek(max(size - len(MAGIC), 0))
    closed = size >= 2 * len(MAGIC) and file.read(len(MAGIC)) == MAGIC
    end = size - len(MAGIC) if closed else size
    at = len(MAGIC)
    file.seek(at)
    while at < end:
        head = file.read(_FRAME.size) if end - at >= _FRAME.size else b""
        if len(head) < _FRAME.size:
            raise TornFile(at, f"{end - at} bytes are left, a record needs {_FRAME.size} at least")
        opcode, length = _FRAME.unpack(head)
        body = at + _FRAME.size
        if opcode == 0:
            raise TornFile(at, "zeros stand where a record should begin")
        if length > end - body:
            raise TornFile(at, f"a record of {length} bytes is announced, {end - body} are left")
        if length > LARGEST_RECORD:
            raise TornFile(at, f"a record of {length} bytes is announced, hil reads {LARGEST_RECORD} at most")
        content = file.read(length)
        if len(content) < length:
            raise TornFile(at, f"a record of {length} bytes is announced, the file was cut")
        yield Record(at, opcode, memoryview(content))
        at = body + length


class Checksums:
    """The checksums that stand at a file's end over all that stands before: data section and summary.

    A chunk has one of its own; metadata, schemas and channels have no other.
    """

    def __init__(self) -> None:
        self._crc = zlib.crc32(MAGIC)
        self.data_ended = False

    def take(self, record: Record) -> None:
        """Take the next record of the file.

        Raises:
            DamagedRecord: if it is the one that holds a checksum, and this does not match.
        """
        frame = _FRAME.pack(record.opcode, len(record.body))
        if record.opcode == Opcode.DATA_END and not self.data_ended:
            found, self._crc, self.data_ended = self._crc, 0, True
            self._compare(found, int.from_bytes(record.body[:4], "little"), "data section", record)
        elif record.opcode == Opcode.FOOTER:
            if not self.data_ended:
                raise DamagedRecord(f"footer at byte {record.offset}: the record that ends the data is missing")
            found = zlib.crc32(record.body[:16], zlib.crc32(frame, self._crc))
            self._compare(found, int.from_bytes(record.body[16:20], "little"), "summary", record)
        else:
            self._crc = zlib.crc32(record.body, zlib.crc32(frame, self._crc))

    @staticmethod
    def _compare(computed: int, expected: int, what: str, record: Record) -> None:
        if expected and computed != expected:  # 0: the writer computed none
            raise DamagedRecord(f"the {what} that ends at byte {record.offset}: the checksum does not match")


class Budget:
    """How much a file may unpack to, all chunks together: a few bytes must not cost gigabytes.

    Args:
        size: length of the file, bytes.
    """

    def __init__(self, size: int) -> None:
        self._limit = max(UNPACKED_FLOOR, UNPACKED_RATIO * size)
        self._left = self._limit

    def take(self, unpacked: int, record: Record) -> None:
        """Take what a record becomes, in bytes.

        Raises:
            TooLarge: that is more than what is left.
        """
        self._left -= unpacked
        if self._left < 0:
            raise TooLarge(
                f"record at byte {record.offset}: the file unpacks to more than {self._limit} bytes, "
                f"{UNPACKED_RATIO} times its own length; no log does"
            )


def parse_attachment(record: Record) -> Attachment:
    """Parse an attachment, and check it against its CRC, which mcap's own reader leaves out.

    Raises:
        DamagedRecord: if it cannot be read whole.
    """
    attachment: Attachment = parse(Attachment.read, record)
    crc = int.from_bytes(record.body[-4:], "little")
    if crc and zlib.crc32(record.body[:-4]) != crc:
        raise DamagedRecord(f"attachment at byte {record.offset}: the checksum does not match")
    return attachment


def framed(content: bytes, record: Record) -> Iterator[tuple[int, int, int, int]]:
    """Give the records of an unpacked chunk in its order: opcode, channel (of messages only), begin and end in the content.

    Args:
        content: of the chunk.
        record: the chunk, for messages.

    Raises:
        DamagedRecord: if the framing is broken, or a message is too short.
    """
    at, end, head = 0, len(content), _HEAD.unpack_from
    while at < end:
        try:
            opcode, length, channel = head(content, at)
        except struct.error:
            raise DamagedRecord(f"chunk at byte {record.offset}: ends within a record") from None
        after = at + 9 + length
        if opcode == 0:
            raise DamagedRecord(f"chunk at byte {record.offset}: zeros stand where a record should begin")
        if after > end:
            raise DamagedRecord(f"chunk at byte {record.offset}: a record of {length} bytes exceeds it")
        if opcode == Opcode.MESSAGE and length < MESSAGE_PAYLOAD_AT - 9:
            raise DamagedRecord(f"chunk at byte {record.offset}: a message of {length} bytes is too short")
        yield opcode, channel, at, after
        at = after


def parse(read: Callable[[ReadDataStream], R], record: Record) -> R:
    """Parse a record by one of mcap's own readers.

    Raises:
        DamagedRecord: whatever goes wrong, with the record's offset.
    """
    try:
        return read(ReadDataStream(BytesIO(record.body)))
    except (McapError, struct.error, ValueError, KeyError, TypeError, OverflowError) as error:
        raise DamagedRecord(f"damaged record at byte {record.offset}: {str(error) or type(error).__name__}") from error


def unpack_chunk(record: Record, budget: Budget) -> bytes:
    """Content of a chunk, uncompressed and checked against its CRC.

    Args:
        record: the chunk.
        budget: of the file.

    Raises:
        DamagedRecord: if it cannot be read whole.
        TooLarge: if the budget is used up.
    """
    chunk = parse(Chunk.read, record)
    where = f"chunk at byte {record.offset}"
    if chunk.uncompressed_size > LARGEST_RECORD:
        raise DamagedRecord(f"{where}: announces {chunk.uncompressed_size} bytes, hil unpacks {LARGEST_RECORD} at most")
    budget.take(chunk.uncompressed_size, record)
    try:
        if chunk.compression == "zstd":
            if zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:  # it is what the decoder would allocate
                raise DamagedRecord(f"{where}: holds more than the {chunk.uncompressed_size} bytes that it announces")
            content = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
        elif chunk.compression == "":
            content = chunk.data
        else:
            raise DamagedRecord(f"{where}: compression {chunk.compression!r} is not supported, expected zstd or none")
    except zstandard.ZstdError as error:
        raise DamagedRecord(f"{where}: {error}") from error
    if len(content) != chunk.uncompressed_size:
        raise DamagedRecord(f"{where}: holds {len(content)} bytes, announces {chunk.uncompressed_size}")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise DamagedRecord(f"{where}: the checksum does not match")
    return content
