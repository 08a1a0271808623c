"""Users' files, read and written: regular and of bounded size, whole or not at all; keys, signatures, arrays, TOML.

Here is the one place in which a file of the user's is opened: regular, of bounded size, never waited for.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from hil.errors import HilError


def read_regular(path: str | Path, most_bytes: int, what: str) -> bytes:
    """Return the bytes of a regular file; see `open_regular`.

    Args:
        path: the file.
        most_bytes: the most that it may have.
        what: what it should be, for the message, with its article ("an experiment file").

    Raises:
        HilError: it cannot be read, is a folder, a pipe or a device, or has more bytes.
    """
    with open_regular(path, what) as file:
        try:
            data = file.read(most_bytes + 1)
        except OSError as e:
            raise HilError(f"{path}: cannot be read: {e.strerror or e}") from e
    if len(data) > most_bytes:
        raise HilError(f"{path}: more than {most_bytes} bytes, the limit of {what}")
    return data


@contextmanager
def open_regular(path: str | Path, what: str, *, follow: bool = True) -> Iterator[BinaryIO]:
    """Open a regular file for reading.

    The type is asked of the open file, so that no pipe can be put in its place between the question and the reading; it
    is opened without waiting, as a pipe without a writer would be waited for without end.

    Args:
        path: the file.
        what: what it should be, for the message, with its article.
        follow: whether the path may be a symbolic link.

    Raises:
        HilError: it cannot be opened, or is a folder, a pipe or a device.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW))
    except (OSError, ValueError) as e:  # ValueError: a name with a zero byte
        raise HilError(f"{path}: cannot be read: {getattr(e, 'strerror', None) or e}") from e
    try:
        refuse_irregular(path, os.fstat(descriptor).st_mode, what)
        with open(descriptor, "rb", closefd=False) as file:
            yield file
    finally:
        os.close(descriptor)


def refuse_irregular(path: str | Path, mode: int, what: str) -> None:
    """Refuse what is no regular file: a device has no end, and a pipe may have no beginning.

    Args:
        path: for the message.
        mode: `st_mode` of the file.
        what: what it should be, with its article.

    Raises:
        HilError: it is no regular file.
    """
    if not stat.S_ISREG(mode):
        raise HilError(f"{path}: is {'a folder' if stat.S_ISDIR(mode) else 'no regular file'}, not {what}")
