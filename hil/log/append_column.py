"""An array that grows at its end: its last rows in memory, the others in a file without a name.

A long run has gigabytes of columns. What is mapped from a file can be given back to the system at any time, so that memory does
not grow with the run. It does not grow in a run's first minutes either: what waits for the file is little, and lies in one place
that is touched from the beginning.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np

Column: TypeAlias = np.ndarray[Any, np.dtype[Any]]
T = TypeVar("T", bound=np.generic)

IN_MEMORY: Final = 2 << 20
"""Bytes up to which the array that is asked for is one in memory, and not mapped from the file."""

PENDING: Final = 1 << 16
"""Bytes that it gathers before it writes them."""

ROWS: Final = 1 << 15
"""Rows of a piece."""


class AppendColumn:
    """Rows of one dtype that come in parts.

    Args:
        dtype: of the rows; no objects.
        folder: where the file without a name is made; the system's folder for temporary files if it cannot be made there.
        pending: bytes that it gathers before it writes them [`PENDING`].
    """

    def __init__(self, dtype: Any, folder: str | os.PathLike[str] | None = None, pending: int | None = None) -> None:
        self.dtype = np.dtype(dtype)
        self._most = max((pending or PENDING) // int(self.dtype.itemsize), 1)  # rows that wait
        self._folder = folder
        self._waiting = np.empty(0, self.dtype)
        self._count = 0  # of them
        self._file: int | None = None
        self._written = 0  # rows in the file
        self._rest: list[Column] = []  # what a full disk refused, and all behind it

    def __len__(self) -> int:
        return self._written + sum(map(len, self._rest)) + self._count

    def extend(self, rows: Column) -> None:
        """Take rows; they are copied to one place, so that many small ones leave no holes in memory where they lay."""
        if self._count + len(rows) > self._most:
            self._write(self._waiting[: self._count])
            self._count = 0
        if len(rows) > self._most or self._rest:
            self._write(rows)
            return
        if not len(self._waiting):
            self._waiting = np.frombuffer(bytearray(self._most * int(self.dtype.itemsize)), self.dtype)  # touched, whole
        self._waiting[self._count : self._count + len(rows)] = rows
        self._count += len(rows)

    def _write(self, rows: Column) -> None:
        if not len(rows):
            return
        if not self._rest:
            try:
                self._append(memoryview(rows.tobytes()))
                self._written += len(rows)
                return
            except OSError:
                pass
        self._rest.append(rows.copy())

    def _append(self, data: memoryview) -> None:
        if self._file is None:
            self._file = _nameless(self._folder)
        done, end = 0, self._written * int(self.dtype.itemsize)
        while done < len(data):
            done += os.pwrite(self._file, data[done:], end + done)

    def array(self) -> Column:
        """Return all rows as one array; one longer than `IN_MEMORY` is mapped from the file, and read only."""
        short = len(self) * int(self.dtype.itemsize) <= IN_MEMORY
        if self._written and not short:
            self._write(self._waiting[: self._count])
            self._count = 0
        parts = [*self._rest, self._waiting[: self._count].copy()]
        if self._file is not None and self._written:
            length = self._written * int(self.dtype.itemsize)
            mapped = np.frombuffer(mmap.mmap(self._file, length, flags=mmap.MAP_SHARED, prot=mmap.PROT_READ), self.dtype)
            parts.insert(0, mapped.copy() if short else mapped)
        parts = [part for part in parts if len(part)]
        if not parts:
            return np.empty(0, self.dtype)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def __del__(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                os.close(self._file)  # what is mapped stays


def _nameless(folder: str | os.PathLike[str] | None) -> int:
    import tempfile  # of runs that are long

    if folder is not None:
        with suppress(OSError), tempfile.TemporaryFile(dir=folder) as file:
            return os.dup(file.fileno())
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def pieces(array: np.ndarray[Any, np.dtype[T]], rows: int = ROWS) -> Iterator[np.ndarray[Any, np.dtype[T]]]:
    """Give an array piece by piece; what a mapped one took of the memory is given back behind every piece.

    Args:
        array: any; of length 0 there is no piece.
        rows: of a piece.
    """
    for start in range(0, len(array), rows):
        yield array[start : start + rows]
        release(array)


def release(array: Column) -> None:
    """Give back the memory of an array that is mapped from a file; it is read again when it is asked for."""
    base: Any = array
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, memoryview):
        base = base.obj
    if isinstance(base, mmap.mmap) and not array.flags.writeable:  # what was written to it would be lost
        base.madvise(mmap.MADV_DONTNEED)


def whole(array: Column, name: str) -> Column:
    """Return one field of a structured array as an array of its own, copied piece by piece."""
    out = np.empty(len(array), array.dtype[name])
    at = 0
    for piece in pieces(array):
        out[at : at + len(piece)] = piece[name]
        at += len(piece)
    return out
