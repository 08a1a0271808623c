"""The participants of a mesh: connections, sockets in one directory, and a mark that changes when a participant joins.

Every participant listens on a socket in the directory and is connected to every other participant. A newcomer connects to all
sockets that it finds there, removes those that no process answers (their owners were killed), and changes the mark.
The mark is read and written, never mapped: whatever is done to its file costs a newcomer, not a life (SIGBUS).
"""

from __future__ import annotations

import os
import select
import socket
import stat
from collections.abc import Sequence
from contextlib import suppress
from errno import EMFILE, ENFILE, ENOBUFS, ENOMEM
from pathlib import Path
from socket import MSG_DONTWAIT, MSG_NOSIGNAL, MSG_PEEK
from struct import Struct
from threading import Lock
from time import time
from typing import Final

from transport.links import TransportError
from transport.links.private_directory import SOCKETS, locked, remove_left_behind

HEAD: Final = Struct("<dH")
"""Time stamp, s, or 0: when the receiver's kernel took it; datagrams lost before this one."""

HEAD_BYTES: Final = 10
"""Size of `HEAD`."""

_TIME: Final = Struct("<d")
_STAMP: Final = Struct("@ll")
_STAMP_SPACE: Final = socket.CMSG_SPACE(_STAMP.size)
_SO_TIMESTAMPNS: Final = 35  # <asm-generic/socket.h>; the socket module does not name it
_SEND_BUFFER: Final = 212_992  # the most that Linux grants without root; holds more than QUEUE_LIMIT, see the tests
_SENT_AT_ONCE: Final = MSG_NOSIGNAL | MSG_DONTWAIT
_LARGEST: Final = 128
_LATEST_S: Final = 1e10  # a time stamp beyond it is none: it may come from anyone, and be no number
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
        stamped: give a datagram whose time is none that of the kernel, which costs its reader a microsecond.
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
        if len(datagram) < HEAD_BYTES or 0.0 < _TIME.unpack_from(datagram)[0] < _LATEST_S:
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


MOST = 64
"""Participants that one lets in: a datagram is sent to each by a call of its own."""

_JOIN_TIMEOUT_S: Final = 2.0
_MARK_BYTES: Final = 8


class Members:
    """All participants, as one of them knows them.

    Args:
        directory: where the participants' sockets are; made if missing, removed by the last one to leave.
        echo: connect to oneself too, see `own`.
        stamped: see `Peer`.

    Attributes:
        peers: whom we send to.
        sources: whose datagrams we receive, by file descriptor.
        lone: the only one of them, None where there are others or none.
        own: our end of a connection to ourselves.
        epoll: says when something waits from a source, or a newcomer.
        closed: whether we have left.
        refused: how often a newcomer found no free file descriptor here, or `MOST` others. It is let in when there is room again.

    Raises:
        TransportError: no such directory can be had, it belongs to another user, or the disk or the descriptors are used up.
    """

    def __init__(self, directory: Path, *, echo: bool, stamped: bool) -> None:
        self.directory, self._stamped = directory, stamped
        self.refused = 0
        self.peers: tuple[Peer, ...] = ()
        self.sources: dict[int, Peer] = {}
        self.lone: Peer | None = None
        self.own: Peer | None = None
        self.closed = False
        self._lock = Lock()
        self._listener: socket.socket | None = None
        self._listening = False  # whether newcomers wake us up
        self._joined = -1  # file descriptor of the mark
        self._seen = b""
        self._knows_all = True
        try:
            self.epoll = select.epoll()
        except OSError as error:
            raise TransportError(f"{directory}: {error.strerror}") from error
        try:
            with locked(directory, _JOIN_TIMEOUT_S):
                self._join()
            if echo:
                ours, own = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                self.own = Peer(ours)
                self._add(self._peer(own))
        except BaseException as error:
            self._release([*self.sources.values()])
            if isinstance(error, OSError):  # no room, no descriptor
                raise TransportError(f"{directory}: {error.strerror or error}") from error
            raise

    def _join(self) -> None:
        peers = []
        for path in sorted(self.directory.glob(SOCKETS)):
            if not stat.S_ISSOCK(path.lstat().st_mode):
                continue  # not ours, and not ours to remove
            connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            connection.setblocking(False)
            try:
                connection.connect(str(path))
            except BlockingIOError:  # alive, stopped, and thousands have knocked already
                connection.close()
                self._knows_all = False
            except (ConnectionRefusedError, FileNotFoundError):
                connection.close()
                path.unlink(missing_ok=True)
            except OSError:  # another kind of socket, not ours
                connection.close()
            else:
                peers.append(self._peer(connection))
                self._add(peers[-1])
        if len(peers) > MOST:
            raise TransportError(f"{self.directory}: more than {MOST} participants; choose another channel")
        self.peers = tuple(peers)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.setblocking(False)
        number = 0
        while (path := self.directory / f"{os.getpid()}-{number}.sock").exists():
            number += 1
        try:
            self._listener.bind(str(path))
        except OSError as error:
            raise TransportError(f"{path}: {error.strerror or error}; a Unix socket's path has at most 107 bytes") from error
        self._path = path
        try:
            self._listener.listen(socket.SOMAXCONN)
            self._listen()
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            self._joined = os.open(self.directory / "joined", flags, 0o600)
            self._seen = os.urandom(_MARK_BYTES)  # no mark comes twice, even where another process cuts the file
            os.pwrite(self._joined, self._seen, 0)  # where the disk is full it fails here, as an error
        except OSError as error:
            path.unlink(missing_ok=True)
            raise TransportError(f"{self.directory / 'joined'}: {error.strerror}") from error

    def _listen(self) -> None:
        if self._listener is not None and not self._listening:
            self.epoll.register(self._listener, select.EPOLLIN)
            self._listening = True

    def unseen(self) -> bool:
        """Return whether a participant has joined that `admit` has not let in."""
        return self._mark() != self._seen

    def _mark(self) -> bytes:
        try:
            return os.pread(self._joined, _MARK_BYTES, 0)
        except OSError:
            if self.closed:  # by another thread, while this one sends: python-can's cyclic senders end when they may
                return self._seen
            raise

    def _peer(self, connection: socket.socket) -> Peer:
        return Peer(connection, stamped=self._stamped)

    def _add(self, peer: Peer) -> None:
        self.sources[peer.socket.fileno()] = peer
        self._count()
        self.epoll.register(peer.socket, select.EPOLLIN)

    def _count(self) -> None:
        self.lone = next(iter(self.sources.values())) if len(self.sources) == 1 else None

    def admit(self) -> None:
        """Let in the participants that have connected since."""
        with self._lock:
            mark = self._mark()
            self._accept_all()
            self._seen = mark  # at last: another thread that sends meanwhile comes here too, and waits

    def _accept_all(self) -> None:
        while not self.closed and self._listener is not None:
            try:
                if len(self.sources) >= MOST:
                    raise OSError(EMFILE, "as many as are let in")
                connection, _ = self._listener.accept()
            except OSError as error:  # none left, or gone again
                if error.errno in (EMFILE, ENFILE, ENOMEM, ENOBUFS) and self._listening:
                    # No one can be let in, and who waits would wake us up without end: look again when one has left.
                    self.epoll.unregister(self._listener)
                    self._listening = self._knows_all = False
                    self.refused += 1
                return
            peer = self._peer(connection)
            self._add(peer)
            self.peers += (peer,)
            self._listen()

    def remove(self, peer: Peer, *, unread: bool) -> None:
        """Send no more to a participant that has left; what it had sent before stays to be read."""
        with self._lock:
            self.peers = tuple(other for other in self.peers if other is not peer)
            if not unread and self.sources.pop(peer.socket.fileno(), None) is not None:
                self._count()
                with suppress(OSError, ValueError):
                    self.epoll.unregister(peer.socket)
                peer.socket.close()
                with suppress(OSError, ValueError):
                    self._listen()

    def leave(self) -> None:
        """Leave; what was sent stays readable for the others. The last one alive clears the directory away."""
        if self.closed:
            return
        with suppress(TransportError, OSError, ValueError), locked(self.directory, 0.2):
            self._path.unlink(missing_ok=True)
            if self._last():
                for path in self.directory.glob(SOCKETS):
                    if stat.S_ISSOCK(path.lstat().st_mode):
                        path.unlink(missing_ok=True)
                remove_left_behind(self.directory)
        with self._lock:
            if self.closed:
                return
            self.closed = True
            sources, self.sources, self.peers, self.lone = self.sources, {}, (), None
        self._path.unlink(missing_ok=True)  # where the lock was not to be had
        self._release([*sources.values()])

    def _release(self, peers: list[Peer]) -> None:
        self.epoll.close()
        if self._listener is not None:
            self._listener.close()
        for peer in [*peers, *([self.own] if self.own else [])]:
            peer.socket.close()
        if self._joined >= 0:
            os.close(self._joined)
            self._joined = -1

    def _last(self) -> bool:
        """Return whether all others have left or were killed; none can join while the lock is held."""
        self.admit()
        poll = select.poll()
        for peer in self.peers:
            poll.register(peer.socket, 0)
        return self._knows_all and sum(bool(event & select.POLLHUP) for _, event in poll.poll(0)) == len(self.peers)
