"""Arrays into one `.npz` file, piece by piece: no array is ever whole in memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from numpy.lib import format as npy


class NpzFile:
    """A file for `numpy.load`, as `numpy.savez_compressed` would write it.

    Args:
        path: the file, which is replaced.
    """

    def __init__(self, path: Path) -> None:
        self._zip = ZipFile(path, "w", ZIP_DEFLATED)

    def add(self, name: str, dtype: np.dtype[Any], shape: tuple[int, ...], parts: Iterator[np.ndarray[Any, Any]]) -> None:
        """Add an array.

        Args:
            name: under which it is read.
            dtype: of all parts.
            shape: of the array.
            parts: its rows, in order.
        """
        with self._zip.open(f"{name}.npy", "w", force_zip64=True) as file:
            _head(file, dtype, shape)
            for part in parts:
                file.write(np.ascontiguousarray(part, dtype).tobytes())

    def __enter__(self) -> NpzFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self._zip.close()


def _head(file: IO[bytes], dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    about = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    try:
        npy.write_array_header_1_0(file, about)
    except ValueError:  # longer than 64 KiB
        npy.write_array_header_2_0(file, about)
