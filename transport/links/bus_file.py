"""The file with the state of a CAN bus that several processes share: its lock, and what follows where a process keeps the lock.

A process that is killed lets go of the lock; one that is stopped (SIGSTOP, a debugger) does not. After `HELD_S` the next process
goes on in a file of the next number, ``bus.1`` behind ``bus.0``, with the state that was last written; only one can make it, as a
link has one name. A process that wakes up finds that there is a newer file, and repeats there what it was about to do. A state is
written beside the one before it, and counts with the head that says where it is: a process that ends in the middle of writing
leaves the one before it.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from struct import Struct
from time import monotonic, sleep
from typing import Final

from transport.links import Closing, TransportError
from transport.links.private_directory import BUS_FILE

HELD_S: Final = 0.25
"""So long a process may hold the bus before the others go on without it, s."""

_HEAD: Final = Struct("<QQ")  # where the state is, and its length
_MOST_BYTES: Final = 4_000_000
_PAUSE_S: Final = 50e-6
_LONGEST_PAUSE_S: Final = 2e-3


class BusFile(Closing):
    """One process's hand on the file.

    Args:
        directory: where the participants meet; it is private and there.

    Raises:
        TransportError: the file cannot be had.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._file = -1
        try:
            self._open_newest()
        except OSError as error:
            raise TransportError(f"{directory / BUS_FILE}: {error.strerror}") from error

    def _path(self, number: int) -> Path:
        return self._directory / f"{BUS_FILE}.{number}"

    def _open_newest(self) -> None:
        self.close()
        names = [path.name.rpartition(".")[2] for path in self._directory.glob(f"{BUS_FILE}.[0-9]*")]
        self._number: int = max((int(name) for name in names if name.isdecimal()), default=0)
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        self._file = os.open(self._path(self._number), flags, 0o600)

    def _is_newest(self) -> bool:
        return os.fstat(self._file).st_nlink > 0 and not self._path(self._number + 1).exists()

    def change(self, change: Callable[[bytes], bytes]) -> None:
        """Replace the state by what a function makes of it, while no other process does.

        Args:
            change: takes the state, empty if there is none. It is called again where others went on without us meanwhile, with
                a state that may hold what the first call returned, or not.
        """
        while True:
            self._lock()
            try:
                text = change(self._read(self._file, self._number))
                if self._is_newest():
                    self._write(text)
                    if self._is_newest():
                        return
            finally:
                fcntl.flock(self._file, fcntl.LOCK_UN)

    def _lock(self) -> None:
        limit, pause = monotonic() + HELD_S, _PAUSE_S
        while True:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if monotonic() < limit:
                    sleep(pause)
                    pause = min(2 * pause, _LONGEST_PAUSE_S)
                    continue
                if self._go_on_without():
                    return
            else:
                if self._is_newest():
                    return
            self._open_newest()
            limit = monotonic() + HELD_S

    def _go_on_without(self) -> bool:
        """Make the file of the next number, locked by us; return False if another process has made it."""
        new = self._directory / f"{BUS_FILE}.new-{os.getpid()}-{self._file}"
        descriptor = os.open(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.link(new, self._path(self._number + 1))
        except FileExistsError:
            os.close(descriptor)
            return False
        finally:
            with suppress(FileNotFoundError):
                new.unlink()
        self.close()
        self._file, self._number = descriptor, self._number + 1
        return True

    def _read(self, file: int, number: int) -> bytes:
        """Return the state; as long as nothing is written in this file that of the one before it."""
        head = os.pread(file, _HEAD.size, 0)
        if len(head) == _HEAD.size:
            place, length = _HEAD.unpack(head)
            if place < 2 * _MOST_BYTES and length <= _MOST_BYTES:  # room for more is memory that must be cleared first
                return os.pread(file, length, place)
            return b""
        if number == 0:
            return b""
        try:
            before = os.open(self._path(number - 1), os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except FileNotFoundError:
            return b""
        try:
            return self._read(before, number - 1)
        finally:
            os.close(before)

    def _write(self, text: bytes) -> None:
        head = os.pread(self._file, _HEAD.size, 0)
        first = len(head) < _HEAD.size
        place = _HEAD.size if first or _HEAD.unpack(head)[0] > _HEAD.size else _HEAD.size + _MOST_BYTES
        os.pwrite(self._file, text, place)
        os.pwrite(self._file, _HEAD.pack(place, len(text)), 0)
        if first and self._number:
            for older in range(self._number):
                self._path(older).unlink(missing_ok=True)

    def close(self) -> None:
        """Let go of the file; may be called twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
