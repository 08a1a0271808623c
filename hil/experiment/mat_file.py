"""One matrix of real numbers from a MATLAB file of version 4 to 7, every byte of which may be a stranger's.

scipy reads these files too, and more of what can stand in them; on some that were damaged it ends the process (SIGBUS).

Reference: MathWorks, "MAT-File Format", R2024b, chapter 1 (versions 5 to 7, "Level 5") and 2 (version 4).
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.errors import HilError

_HEADER: Final = 128
_MATRIX, _COMPRESSED = 14, 15
_STORED: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Number types of the elements of a file of version 5 to 7."""

_NUMERIC: Final = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_OTHER: Final = {1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 16: "function", 17: "opaque"}
"""Array classes of these versions."""

_COMPLEX, _LOGICAL = 0x0800, 0x0200
_OLD: Final = ("f8", "f4", "i4", "i2", "u2", "u1")
"""Number types of version 4."""


class Variable(NamedTuple):
    """One variable of a file.

    Attributes:
        name: as MATLAB calls it.
        kind: "numbers", or why it is no full matrix of real numbers: char, cell, struct, sparse, complex, ...
        shape: its lengths.
        stored, dtype: numpy's codes of the numbers in the file, and of the array.
        data: the bytes of the numbers, the first index changing first.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    stored: str
    dtype: str
    data: memoryview

    def array(self) -> NDArray[Any]:
        """Return the numbers.

        Raises:
            ValueError: there are fewer of them than the shape says.
        """
        count = math.prod(self.shape)
        found: NDArray[Any] = np.frombuffer(self.data, self.stored, count).astype(self.dtype).reshape(self.shape, order="F")
        return found


def variables(data: bytes, most_bytes: int) -> Iterator[Variable]:
    """Yield the variables of a file, one after the other.

    Args:
        data: the file.
        most_bytes: the most that its compressed variables may hold, all together.

    Raises:
        HilError: it is of another version, or holds more.
        ValueError: it is torn.
        struct.error, zlib.error: it is torn.
    """
    if data[:10] == b"MATLAB 7.3":
        raise HilError("is a MATLAB 7.3 file; save it with -v7")
    if 0 in data[:4]:
        yield from _version_4(data)
        return
    order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER])
    if order is None:
        raise ValueError("has no header of MATLAB")
    left = most_bytes
    for kind, body in _elements(memoryview(data)[_HEADER:], order, padded=False):
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(body, left + 1)
            left -= len(unpacked)
            if left < 0:
                raise HilError(f"unpacks to more than {most_bytes} bytes")
            kind, body = next(_elements(memoryview(unpacked), order), (0, memoryview(b"")))
        if kind == _MATRIX:
            yield _matrix(body, order)


def _elements(data: memoryview, order: str, padded: bool = True) -> Iterator[tuple[int, memoryview]]:
    """Yield type and bytes of the elements that stand one after the other; a short one has both in 8 bytes."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:
            kind, size, begin, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if size > 4:
                raise ValueError(f"an element of {size} bytes in the room of 4")
        else:
            begin = at + 8
            after = begin + size + (-size % 8 if padded or kind != _COMPRESSED else 0)
        if begin + size > len(data):
            raise ValueError(f"an element of {size} bytes is announced, {len(data) - begin} are left")
        yield kind, data[begin : begin + size]
        at = after


def _matrix(body: memoryview, order: str) -> Variable:
    parts = _elements(body, order)
    flags, dims, name, numbers = (next(parts, (0, memoryview(b"")))[:2] for _ in range(4))
    (said,) = struct.unpack_from(f"{order}I", flags[1])
    if dims[0] != 5 or len(dims[1]) % 4 or len(dims[1]) < 8:
        raise ValueError("a variable has no lengths")
    shape = struct.unpack(f"{order}{len(dims[1]) // 4}i", dims[1])
    called = bytes(name[1]).decode("latin-1")
    group = said & 0xFF
    dtype = _NUMERIC.get(group)
    kind = "numbers" if dtype is not None else _OTHER.get(group, f"class {group}")
    if dtype is not None and said & _COMPLEX:
        kind = "complex"
    if dtype is None or kind != "numbers" or min(shape) < 0:
        return Variable(called, kind if min(shape) >= 0 else "negative lengths", shape, "u1", "u1", memoryview(b""))
    stored = _STORED.get(numbers[0])
    if stored is None:
        raise ValueError(f"{called[:40]!r}: numbers of the unknown type {numbers[0]}")
    return Variable(called, kind, shape, order + stored, "?" if said & _LOGICAL else dtype, numbers[1])


def _version_4(data: bytes) -> Iterator[Variable]:
    order = "<" if 0 <= struct.unpack_from("<i", data)[0] < 5000 else ">"
    at = 0
    while at < len(data):
        said, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", data, at)
        (machine, rest), what, group = divmod(said, 1000), said // 10 % 10, said % 10
        if machine not in (0, 1) or rest >= 100 or what >= len(_OLD) or min(rows, columns, length) < 0:
            raise ValueError(f"at byte {at} stands no variable of version 4")
        begin, stored = at + 20 + length, np.dtype(("<", ">")[machine] + _OLD[what])
        size = rows * columns * stored.itemsize
        if begin + size * (1 + bool(imaginary)) > len(data):
            raise ValueError(f"a matrix of {rows} x {columns} is announced, {len(data) - begin} bytes are left")
        kind = ("numbers", "char", "sparse")[group] if group < 3 else f"class {group}"
        name = data[at + 20 : begin].rstrip(b"\0").decode("latin-1")
        yield Variable(name, "complex" if imaginary and kind == "numbers" else kind, (rows, columns), stored.str, stored.str[1:],
                       memoryview(data)[begin : begin + size])  # fmt: skip
        at = begin + size * (1 + bool(imaginary))
