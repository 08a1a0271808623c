"""An MCAP file that is open for reading: what it is, and how long, is asked of the open file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from hil.errors import HilError
from hil.files.regular import refuse_irregular
from hil.log.read.mcap_walk import MAGIC


@contextmanager
def open_mcap(path: Path, descriptor: int | None = None) -> Iterator[tuple[BinaryIO, int]]:
    """Give a file that begins as MCAP does, and its length in bytes.

    Args:
        path: the file, for opening and for messages.
        descriptor: the file, open already (its name may be gone); it stays open.

    Raises:
        HilError: if it cannot be read, is no regular file (a device has no end), is empty, or begins otherwise.
    """
    try:
        own = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC) if descriptor is None else os.dup(descriptor)
    except (OSError, ValueError) as error:
        raise HilError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    try:
        status = os.fstat(own)
        refuse_irregular(path, status.st_mode, "an MCAP log")
        with open(own, "rb", buffering=1 << 18, closefd=False) as file:
            file.seek(0)
            head = file.read(len(MAGIC))
            if not head:
                raise HilError(f"{path}: is empty, expected an MCAP log")
            if head != MAGIC:
                raise HilError(f"{path}: is no MCAP file: byte 0 begins {head!r}, expected {MAGIC!r}")
            yield file, status.st_size
    except OSError as error:
        raise HilError(f"{path}: cannot be read: {error.strerror or error}") from error
    finally:
        os.close(own)
