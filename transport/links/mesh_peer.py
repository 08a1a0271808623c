"""One connection of the mesh: what it carries and what it missed, and what killed processes left of theirs.

They leave sockets that nothing listens at, and the folders of them.
"""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from socket import MSG_DONTWAIT, MSG_NOSIGNAL, MSG_PEEK
from struct import Struct
from time import time
from typing import Final

from transport.links import TransportError
from transport.links.private_directory import locked

HEAD: Final = Struct("<dH")
"""Time stamp, s, or 0: when the kernel of who reads it took it; datagrams lost before this one."""

HEAD_BYTES: Final = 10
"""Size of `HEAD`."""

_TIME: Final = Struct("<d")
_STAMP: Final = Struct("@ll")
_STAMP_SPACE: Final = socket.CMSG_SPACE(_STAMP.size)
_SO_TIMESTAMPNS: Final = 35  # <asm-generic/socket.h>; the socket module does not name it
_SEND_BUFFER: Final = 212_992  # the most that Linux grants without root; holds more than QUEUE_LIMIT, see the tests
_SENT_AT_ONCE: Final = MSG_NOSIGNAL | MSG_DONTWAIT
_LARGEST: Final = 128
_PATIENCE: Final = Struct("@ll").pack(0, 50_000)  # s and us that `await_one` waits


def _stamp_what_waits(connection: socket.socket) -> None:
    """Have the kernel stamp the datagram that came before this socket asked for stamps.

    It stamps such a datagram when it is first looked at: later than what others send meanwhile, which would be read first.
    Only the first: several that came before are in turn with those of others who were let in at the same time.
    """
    with suppress(BlockingIOError):
        connection.recvmsg(1, _STAMP_SPACE, MSG_PEEK | MSG_DONTWAIT)


class Peer:
    """One connection, and how many datagrams it missed since the last one that got through.

    Args:
        connection: a socket of datagrams that is connected.
        stamped: give a datagram that says no time the kernel's, which costs who reads it a microsecond.
    """

    __slots__ = ("_recv", "_send", "_stamped", "missed", "socket")

    def __init__(self, connection: socket.socket, *, stamped: bool = False) -> None:
        connection.setblocking(True)  # what may not wait says so: no time that Python keeps, one system call in `await_one`
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _PATIENCE)
        with suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        with suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            _stamp_what_waits(connection)
        self.socket, self._stamped = connection, stamped
        self._send, self._recv = connection.send, connection.recv
        self.missed = 0

    def read(self) -> bytes:
        """Return the next datagram, b"" where the other end has left; `BlockingIOError` if there is none."""
        return self._with_time(MSG_DONTWAIT) if self._stamped else self._recv(_LARGEST, MSG_DONTWAIT)

    def await_one(self) -> bytes:
        """Wait up to 50 ms for the next datagram, and `read` it: asleep in the call that reads, which no other has to follow."""
        return self._with_time(0) if self._stamped else self._recv(_LARGEST)

    def _with_time(self, flags: int) -> bytes:
        datagram, said, _, _ = self.socket.recvmsg(_LARGEST, _STAMP_SPACE, flags)
        if len(datagram) < HEAD_BYTES or _TIME.unpack_from(datagram)[0]:
            return datagram
        arrived_ns = _stamp(said)  # -1 on a kernel that stamps nothing
        return _TIME.pack(arrived_ns / 1e9 if arrived_ns >= 0 else time()) + datagram[_TIME.size :]

    def offer(self, datagram: bytes) -> None:
        """Send, or raise `OSError`; never wait."""
        if not self.missed:
            self._send(datagram, _SENT_AT_ONCE)
            return
        reported = min(self.missed, 0xFFFF)
        self._send(HEAD.pack(HEAD.unpack_from(datagram)[0], reported) + datagram[HEAD_BYTES:], _SENT_AT_ONCE)
        self.missed -= reported

    def arrival_ns(self) -> int:
        """Return when the kernel took the datagram that waits here, ns; -1 where nothing says so: it is read at once."""
        try:
            _, said, _, _ = self.socket.recvmsg(1, _STAMP_SPACE, MSG_PEEK | MSG_DONTWAIT)
        except OSError:
            return -1
        return _stamp(said)


def _stamp(said: Sequence[tuple[int, int, bytes]]) -> int:
    """Return the kernel's stamp among what it said of a datagram, ns since 1970; -1 where it is missing."""
    for level, kind, data in said:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) == _STAMP.size:
            seconds, nanoseconds = _STAMP.unpack(data)
            return int(seconds) * 1_000_000_000 + int(nanoseconds)
    return -1


BUS_FILE: Final = "bus"
LEFT_BEHIND: Final = ("joined", f"{BUS_FILE}.*")
"""Files beside the sockets of a channel: the mark of the mesh, and the state of a bus that takes time."""

SOCKETS: Final = "[0-9]*-[0-9]*.sock"
"""Process and number: the names of the sockets of a channel."""

_LOCK_S: Final = 0.01


def bus_directory() -> Path:
    """Return the directory that holds the buses of this user.

    It does not depend on the login session, so that a service, a cron job and a shell of one user meet.
    """
    return Path(os.environ.get("HIL_CAN_DIR") or f"/tmp/hil-can-{os.geteuid()}")


def clear_dead_channels(directory: Path) -> None:
    """Remove the sockets of ended processes, and each channel that has no other; what cannot be removed stays.

    A live channel notices nothing: no socket of a process that runs is touched.

    Args:
        directory: holds a folder for every channel.
    """
    with suppress(OSError):
        for channel in [each for each in directory.iterdir() if not each.is_symlink() and each.is_dir()]:
            if all(map(_process_runs, channel.glob(SOCKETS))) and any(channel.glob(SOCKETS)):
                continue
            with suppress(TransportError, OSError), locked(channel, _LOCK_S):
                for path in channel.glob(SOCKETS):
                    if _is_dead(path):
                        path.unlink(missing_ok=True)
                if not any(channel.glob(SOCKETS)):
                    remove_left_behind(channel)


def remove_left_behind(channel: Path) -> None:
    """Remove the folder of a channel without sockets, unless other files are in it.

    Raises:
        OSError: it is not empty, or another user's.
    """
    if all(any(path.match(name) for name in LEFT_BEHIND) for path in channel.iterdir()):
        for path in channel.iterdir():
            path.unlink(missing_ok=True)
    channel.rmdir()


def _process_runs(path: Path) -> bool:
    return Path(f"/proc/{path.name.partition('-')[0]}").exists()


def _is_dead(path: Path) -> bool:
    """Whether nothing listens at a socket; the process of another container is not seen here, but answers."""
    if _process_runs(path) or not stat.S_ISSOCK(path.lstat().st_mode):
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as knock:
        knock.setblocking(False)
        try:
            knock.connect(os.fspath(path))
        except ConnectionRefusedError:
            return True
        except OSError:
            pass
    return False
