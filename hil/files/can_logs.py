"""CAN logs that other programs wrote, frame by frame."""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final

from hil.errors import HilError
from hil.files import open_regular

if TYPE_CHECKING:
    import can


CAN_LOG_ENDINGS: Final = (".log", ".asc", ".blf")
LATEST_S: Final = 1e12
"""Of a recorded instant, s: what is beyond it is none."""
LONGEST_LINE: Final = 4096
LARGEST: Final = 1 << 24
"""Bytes of an object of a BLF file, packed or not; Vector's programs gather 128 kB in one."""
RATIO: Final = 40
"""How many times its own length a BLF file may unpack to, above `LARGEST`."""

_FILE_HEAD: Final = 144
_OBJECT: Final = struct.Struct("<4sHHII")
"""Head of every object: LOBJ, length of the head, its version, length of the object, kind."""

_CONTAINER, _PACKED = 10, 2
_PACKING: Final = struct.Struct("<H6xL4x")
_PLAIN: Final = struct.Struct("<4sHHIIH6xL4x")


def can_frames(path: Path) -> Iterator[can.Message]:
    """Yield the frames of a file that ends in .log, .asc or .blf.

    It is candump's or Vector's text, or BLF with a bound on what it unpacks to.

    Raises:
        HilError: it cannot be read, is no regular file, or is no such log; a time stamp is no instant.
    """
    for number, frame in enumerate(_frames(path), 1):
        if not abs(frame.timestamp) < LATEST_S:
            raise HilError(f"{path}: frame {number}: {frame.timestamp!r:.40} is no instant, expected seconds below {LATEST_S:g}")
        yield frame


def _frames(path: Path) -> Iterator[can.Message]:
    from transport.links.python_can import can

    if path.suffix not in CAN_LOG_ENDINGS:
        raise HilError(f"{path}: the ending {path.suffix!r} names no CAN log, expected .log, .asc or .blf (see `hil export`)")
    try:
        with open_regular(path, "a CAN log") as file:
            if path.suffix == ".blf":
                for part in _parts(file):
                    yield from can.BLFReader(io.BytesIO(part))
            elif path.suffix == ".asc":
                yield from can.ASCReader(_Lines(file))  # type: ignore[arg-type]
            else:
                yield from can.CanutilsLogReader(_Lines(file))  # type: ignore[arg-type]
    except (OSError, ValueError, ArithmeticError, LookupError, EOFError, struct.error, zlib.error, can.CanError,
            can.io.blf.BLFParseError) as e:  # fmt: skip
        wanted = "; expected lines as `candump -L can0` prints them: (12.345678) can0 123#1122" if path.suffix == ".log" else ""
        raise HilError(f"{path}: is no CAN log: {str(e) or type(e).__name__:.200}{wanted}") from e


class _Lines(io.TextIOBase):
    """The lines of a file, none of them without an end."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def __next__(self) -> str:  # type: ignore[override]
        line = self.readline()
        if not line:
            raise StopIteration
        return line

    def readline(self, size: int | None = -1) -> str:  # type: ignore[override]
        line = self._file.readline(LONGEST_LINE)
        if len(line) == LONGEST_LINE:
            raise ValueError(f"a line has more than {LONGEST_LINE} bytes")
        return line.decode()


def _parts(file: BinaryIO) -> Iterator[bytes]:
    """Yield files of the whole objects of one container each, not packed: what python-can would unpack without a bound."""
    head = file.read(_FILE_HEAD)
    if len(head) < _FILE_HEAD or head[:4] != b"LOGG":
        raise ValueError("the head of the file is missing")
    (size,) = struct.unpack_from("<I", head, 4)
    file.seek(max(size, _FILE_HEAD))
    rest, left = bytearray(), max(LARGEST, RATIO * os.fstat(file.fileno()).st_size)
    while begin := file.read(_OBJECT.size):
        mark, _, _, length, kind = _OBJECT.unpack(begin)
        if mark != b"LOBJ" or not _OBJECT.size <= length <= LARGEST:
            raise ValueError(f"no object of {_OBJECT.size} to {LARGEST} bytes begins at byte {file.tell() - _OBJECT.size}")
        body = file.read(length - _OBJECT.size)
        file.read(length % 4)
        if kind == _CONTAINER:
            found = _unpacked(body)
            left -= len(found)
            if left < 0:
                raise ValueError(f"it unpacks to more than {RATIO} times its own length")
            rest += found
            whole = _whole_objects(rest)
            if whole:
                yield head + _PLAIN.pack(b"LOBJ", 16, 1, _PLAIN.size + whole, _CONTAINER, 0, whole) + rest[:whole]
            del rest[:whole]


def _unpacked(body: bytes) -> bytes:
    method, _ = _PACKING.unpack_from(body)
    if method == 0:
        return body[_PACKING.size :]
    if method != _PACKED:
        raise ValueError(f"a container is packed by method {method}, expected 0 or {_PACKED}")
    found = zlib.decompressobj().decompress(body[_PACKING.size :], LARGEST + 1)
    if len(found) > LARGEST:
        raise ValueError(f"a container unpacks to more than {LARGEST} bytes")
    return found


def _whole_objects(data: bytearray) -> int:
    """Return where the last object ends of which all bytes are there."""
    end = 0
    while True:
        begin = data.find(b"LOBJ", end, end + 8)
        if begin < 0:
            if len(data) - end > 8:
                raise ValueError("no object begins where the one before ends")
            return end
        if len(data) - begin < _OBJECT.size:
            return end
        length = _OBJECT.unpack_from(data, begin)[3]
        if not _OBJECT.size <= length <= LARGEST:
            raise ValueError(f"an object of {length} bytes, expected {_OBJECT.size} to {LARGEST}")
        if begin + length > len(data):
            return end
        end = begin + length
