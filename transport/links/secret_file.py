"""A file that holds a secret: regular, small, and nobody's to read but its owner's."""

from __future__ import annotations

import os
import stat

from transport.links.link import TransportError

MOST_BYTES = 65_536


def read_secret(path: str, what: str) -> bytes:
    """Return the bytes of a secret file.

    Type and mode are asked of the open file, so that nobody can put another in its place between question and reading.

    Args:
        path: the file.
        what: what it should be, with its article ("the key of the frames"), for the message.

    Raises:
        TransportError: it cannot be read, is no regular file, is too large, or others than its owner may read or write it.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise TransportError(f"{path}: is no regular file, not {what}")
            if stat.S_IMODE(status.st_mode) & 0o077:
                raise TransportError(f"{path}: other users can read it (mode {stat.S_IMODE(status.st_mode):o}); chmod 600 it")
            data = os.read(descriptor, MOST_BYTES + 1)
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        raise TransportError(f"{path}: {what} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > MOST_BYTES:
        raise TransportError(f"{path}: more than {MOST_BYTES} bytes, too many for {what}")
    return data
