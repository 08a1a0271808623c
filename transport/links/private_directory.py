"""A directory that is one user's alone, and the lock by which processes that meet in it take turns."""

from __future__ import annotations

import fcntl
import os
import select
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from transport.links.link import TransportError


@contextmanager
def locked(root: Path, timeout_s: float) -> Iterator[None]:
    """Hold the lock on a directory, made if missing; a killed holder's lock is void.

    Args:
        root: the directory; in a place where others may write, such as /tmp, it must be ours already or not exist.
        timeout_s: how long to wait for the lock, s.

    Raises:
        TransportError: it belongs to somebody else, others may enter it, it is a symbolic link, or the lock is not to be had.
    """
    try:
        root.mkdir(mode=0o700, exist_ok=True)
        descriptor = os.open(root, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        raise TransportError(f"{root}: {error.strerror}") from error
    try:
        status = os.fstat(descriptor)
        if status.st_uid != os.geteuid() or stat.S_IMODE(status.st_mode) & 0o077:
            need = f"must be a directory of user {os.geteuid()} with mode 700"
            raise TransportError(f"{root}: {need}; chmod 700 it, or choose another directory")
        pause = select.poll()
        for _ in range(max(1, round(timeout_s / 0.01))):
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                pause.poll(10)
        else:
            raise TransportError(f"{root}: locked for {timeout_s:g} s by a process that is stopped while it joins")
        yield
    finally:
        os.close(descriptor)
