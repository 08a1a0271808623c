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

_PAUSE_MS = 10
_TRIES = 100


@contextmanager
def locked(directory: Path, timeout_s: float) -> Iterator[None]:
    """Hold the lock on a directory in a private one, both made if missing; a killed holder's lock is void.

    The lock is the directory's own: a process that is stopped while it holds it bars this directory and no other.

    Args:
        directory: where processes meet. Where others may write, such as in /tmp, it and its parent must be ours already or
            not exist.
        timeout_s: how long to wait for the lock, s.

    Raises:
        TransportError: it or its parent belongs to somebody else, others may enter it, it is a symbolic link, there is no room
            for it, or the lock is not to be had.
    """
    os.close(_private(directory.parent))
    pause = select.poll()
    for _ in range(max(1, round(timeout_s / (_PAUSE_MS / 1000)))):
        descriptor = _private(directory)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(descriptor, directory):  # the last one to leave has not removed it while we opened it
                yield
                return
        except BlockingIOError:
            pause.poll(_PAUSE_MS)
        finally:
            os.close(descriptor)
    raise TransportError(
        f"{directory}: locked for {timeout_s:g} s by a process that is stopped while it joins; "
        "let it go on or end it, or choose another channel"
    )


def _private(directory: Path) -> int:
    """Open a directory that is ours alone, made if missing, and made again if another process clears it away in between."""
    for left in reversed(range(_TRIES)):
        try:
            directory.mkdir(mode=0o700, exist_ok=True)
            descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            break
        except OSError as error:
            if not isinstance(error, FileNotFoundError) or not left:
                raise TransportError(f"{directory}: {error.strerror}") from error
    status = os.fstat(descriptor)
    if status.st_uid != os.geteuid() or stat.S_IMODE(status.st_mode) & 0o077:
        os.close(descriptor)
        need = f"must be a directory of user {os.geteuid()} with mode 700"
        raise TransportError(f"{directory}: {need}; chmod 700 it, or choose another directory")
    return descriptor


def private_directory(directory: Path) -> Path:
    """Return a directory that is ours alone (mode 700), made if missing.

    Args:
        directory: in a directory where others may write, such as /tmp, it must be ours already or not exist.

    Raises:
        TransportError: it belongs to somebody else, others may enter it, it is a symbolic link, or there is no room for it.
    """
    os.close(_private(directory))
    return directory


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except FileNotFoundError:
        return False
