"""Processes of one user that receive each other's datagrams, over Unix sockets, without a broker.

Every participant listens on a socket in one directory and is connected to every other participant. A newcomer connects to
all sockets that it finds there, removes those that no process answers (their owners were killed), and changes a shared mark;
a sender that sees the mark changed lets the newcomers in and sends to them too. Hence everyone receives whatever is sent after it
joined. The mark is read behind the sending, which who waits for the datagram does not wait for.
The mark is read and written, never mapped: whatever is done to its file costs a newcomer, not a life (SIGBUS).

The kernel queues up to `QUEUE_LIMIT` datagrams from each sender at each receiver. Beyond that a datagram is lost for this
receiver only: the sender counts it as dropped, and the next datagram that gets through carries to the receiver how many it
missed. No participant ever waits for another, be it slow, stopped or dead.

A datagram begins with `mesh_peer.HEAD`: the time it was sent, for who logs it, and the number of datagrams missed before it,
which is the mesh's to fill in. A receiver merges its senders by the instant at which its own kernel took each datagram: what a
sender says of the time decides nothing, or who says 0 would always come first.
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
from threading import Lock
from typing import Final

from transport.links.link import Closing, TransportError
from transport.links.mesh_peer import HEAD_BYTES, SOCKETS, Peer, remove_left_behind
from transport.links.private_directory import locked

QUEUE_LIMIT: Final = 256
"""So many datagrams of up to 80 bytes wait at least at a receiver, from each sender."""

POLLS: Final = 400
"""How often a short wait looks for an answer before it sleeps: about 200 us."""
_MOST_IN_VAIN: Final = 8

_LARGEST: Final = 128
_JOIN_TIMEOUT_S: Final = 2.0
_MARK_BYTES: Final = 8
_COARSE_S: Final = 0.05  # epoll rounds up to milliseconds: good enough for a wait as long as this


class Mesh(Closing):
    """One participant.

    Args:
        directory: where the participants' sockets are; made if missing, removed by the last one to leave.
        echo: receive one's own datagrams too (those given to `echo`).
        looks: look for an answer before a short wait sleeps; not where another thread of this process sends it, which would
            wait for the interpreter meanwhile.

    Attributes:
        dropped: datagrams this participant could not hand to another one whose queue was full.
        lost: datagrams others could not hand to this one.
        refused: how often a newcomer found no free file descriptor here. It is let in when one is free again.

    Raises:
        TransportError: no such directory can be had, it belongs to another user, or the disk or the descriptors are used up.
    """

    def __init__(self, directory: Path, *, echo: bool = False, looks: bool = True) -> None:
        self.directory = directory
        self.dropped = self.lost = self.refused = 0
        self._lock = Lock()
        self._peers: tuple[Peer, ...] = ()  # whom we send to
        self._sources: dict[int, Peer] = {}  # whose datagrams we receive, by file descriptor
        self._own: Peer | None = None
        self._listener: socket.socket | None = None
        self._listening = False  # whether newcomers wake us up
        self._joined = -1  # file descriptor of the mark
        self._seen = b""
        self._closed = False
        self._knows_all = True
        self._looks = looks
        self._rest = self._vain = 0  # short waits that will not look first; looks in vain, one after the other
        try:
            self._epoll = select.epoll()
        except OSError as error:
            raise TransportError(f"{directory}: {error.strerror}") from error
        try:
            with locked(directory, _JOIN_TIMEOUT_S):
                self._join()
            if echo:
                ours, own = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                self._own = Peer(ours)
                self._add(Peer(own))
        except BaseException as error:
            self._release([*self._sources.values()])
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
                peers.append(Peer(connection))
                self._add(peers[-1])
        self._peers = tuple(peers)
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
            self._seen = os.urandom(_MARK_BYTES)  # no mark comes twice, whoever cuts the file
            os.pwrite(self._joined, self._seen, 0)  # where the disk is full it fails here, as an error
        except OSError as error:
            path.unlink(missing_ok=True)
            raise TransportError(f"{self.directory / 'joined'}: {error.strerror}") from error

    def _listen(self) -> None:
        if self._listener is not None and not self._listening:
            self._epoll.register(self._listener, select.EPOLLIN)
            self._listening = True

    def _mark(self) -> bytes:
        try:
            return os.pread(self._joined, _MARK_BYTES, 0)
        except OSError:
            if self._closed:  # by another thread, while this one sends: python-can's cyclic senders end when they may
                return self._seen
            raise

    def _add(self, peer: Peer) -> None:
        self._sources[peer.socket.fileno()] = peer
        self._epoll.register(peer.socket, select.EPOLLIN)

    def _admit(self) -> None:
        """Let in whoever has connected since."""
        with self._lock:
            mark = self._mark()
            self._accept_all()
            self._seen = mark  # at last: whoever sends meanwhile from another thread comes here too, and waits

    def _accept_all(self) -> None:
        while not self._closed and self._listener is not None:
            try:
                connection, _ = self._listener.accept()
            except OSError as error:  # none left, or gone again
                if error.errno in (EMFILE, ENFILE, ENOMEM, ENOBUFS) and self._listening:
                    # No one can be let in, and who waits would wake us up without end: look again when one has left.
                    self._epoll.unregister(self._listener)
                    self._listening = False
                    self.refused += 1
                return
            peer = Peer(connection)
            self._add(peer)
            self._peers += (peer,)
            self._listen()

    def _remove(self, peer: Peer, *, unread: bool) -> None:
        """Send no more to a participant that has left; what it had sent before stays to be read."""
        with self._lock:
            self._peers = tuple(other for other in self._peers if other is not peer)
            if not unread and self._sources.pop(peer.socket.fileno(), None) is not None:
                with suppress(OSError, ValueError):
                    self._epoll.unregister(peer.socket)
                peer.socket.close()
                with suppress(OSError, ValueError):
                    self._listen()

    def send(self, datagram: bytes, wait_s: float = 0.0) -> bool:
        """Send to everyone.

        Args:
            datagram: `HEAD` and up to 70 bytes.
            wait_s: how long to wait for room in a full queue, s.

        Returns:
            Whether a participant took it, or there is none; False if none of them had room.
        """
        peers = self._peers
        taken, full = self._offer(peers, datagram, wait_s)
        if self._mark() != self._seen:  # looked at when the others have it already, who wait for it
            self._admit()
        if self._peers is not peers:
            late, full_too = self._offer([peer for peer in self._peers if peer not in peers], datagram, wait_s)
            taken, full = taken or late, full or full_too
        return taken or not full

    def _offer(self, peers: Sequence[Peer], datagram: bytes, wait_s: float) -> tuple[bool, bool]:
        """Return whether one of them took it, and whether one had no room."""
        taken = full = False
        for peer in peers:
            try:
                peer.offer(datagram)
                taken = True
            except OSError as error:
                full |= not self._not_sent(peer, datagram, error, wait_s)
        return taken, full

    def _not_sent(self, peer: Peer, datagram: bytes, error: OSError, wait_s: float) -> bool:
        """Try again or count it; return False if the participant is there and had no room."""
        if isinstance(error, BlockingIOError) or error.errno == ENOBUFS:
            if wait_s > 0 and select.select((), (peer.socket,), (), wait_s)[1]:
                with suppress(OSError):
                    peer.offer(datagram)
                    return True
            peer.missed += 1
            self.dropped += 1
            return False
        try:
            unread = bool(peer.socket.recv(1, socket.MSG_PEEK))
        except ConnectionResetError:
            unread = True  # it left without reading all of ours; its own may still be here
        except OSError:
            unread = False
        self._remove(peer, unread=unread)
        return True

    def echo(self, datagram: bytes) -> None:
        """Hand a datagram to oneself."""
        if self._own is not None:
            try:
                self._own.socket.send(datagram)
            except OSError:
                self.dropped += 1

    def receive(self, timeout_s: float | None) -> bytes | None:
        """Return the next datagram, of all that wait the one that arrived first, or None.

        None may come before the time is up, when nothing but a coming or going happened.

        Args:
            timeout_s: s; None waits for ever.
        """
        ready = self._epoll.poll(timeout_s if timeout_s is None or timeout_s >= _COARSE_S else 0)
        if not ready and timeout_s is not None and 0 < timeout_s < _COARSE_S:
            found = self._look() if self._looks else []
            if isinstance(found, bytes):
                return found
            ready = found or self._sleep(timeout_s)
        while ready:
            descriptor = ready[0][0] if len(ready) == 1 else min(ready, key=self._time)[0]
            peer = self._sources.get(descriptor)
            if peer is None:
                self._admit()
            else:
                datagram = self._read(peer)
                if datagram is not None:
                    return datagram
            ready = self._epoll.poll(0)
        return None

    def _read(self, peer: Peer) -> bytes | None:
        """Return the next datagram of a participant, None if there is none."""
        try:
            datagram = peer.read(_LARGEST)
        except OSError:  # another thread took it, or the other end has left: what it sent is read next
            return None
        if len(datagram) >= HEAD_BYTES:
            self.lost += datagram[8] | datagram[9] << 8
            return datagram
        if not datagram:
            self._remove(peer, unread=False)
        return None

    def _look(self) -> bytes | list[tuple[int, int]]:
        """Look for an answer without sleep; return what came, or what epoll has, [] if nothing came.

        Who waits briefly waits for an answer, and waking up from a sleep would double its way. Where looking does not help, as
        when both ends share one CPU, it is given up, and tried again ever more rarely.
        """
        if self._rest:
            self._rest -= 1
            return []
        lone = next(iter(self._sources.values())) if len(self._sources) == 1 else None
        for _ in range(POLLS):
            # A lone participant is read without asking epoll whether it can be: none but a newcomer could have come first.
            found = self._epoll.poll(0) if lone is None else self._read(lone)
            if found:
                self._vain = 0
                return found
        self._vain += 1
        if self._vain >= _MOST_IN_VAIN:
            self._rest = 1 << min(self._vain, 14)
        return []

    def _sleep(self, timeout_s: float) -> list[tuple[int, int]]:
        """Wait more exactly than epoll does, which counts milliseconds."""
        with suppress(ValueError):  # more than 1024 open files
            if not select.select((self._epoll,), (), (), timeout_s)[0]:
                return []
            timeout_s = 0.0
        return self._epoll.poll(timeout_s)

    def _time(self, event: tuple[int, int]) -> int:
        peer = self._sources.get(event[0])
        if peer is None:
            return -1  # newcomers first
        return peer.arrival_ns()

    def fileno(self) -> int:
        """Return a descriptor that is readable while something waits; -1 after `close`."""
        return -1 if self._closed else self._epoll.fileno()

    @property
    def participants(self) -> int:
        """Number of participants, this one included, as far as known."""
        return len(self._peers) + 1

    def close(self) -> None:
        """Leave; what was sent stays readable for the others. The last one alive clears the directory away."""
        if self._closed:
            return
        with suppress(TransportError, OSError, ValueError), locked(self.directory, 0.2):
            self._path.unlink(missing_ok=True)
            if self._last():
                for path in self.directory.glob(SOCKETS):
                    if stat.S_ISSOCK(path.lstat().st_mode):
                        path.unlink(missing_ok=True)
                remove_left_behind(self.directory)
        with self._lock:
            if self._closed:
                return
            self._closed = True
            sources, self._sources, self._peers = self._sources, {}, ()
        self._path.unlink(missing_ok=True)  # where the lock was not to be had
        self._release([*sources.values()])

    def _release(self, peers: list[Peer]) -> None:
        self._epoll.close()
        if self._listener is not None:
            self._listener.close()
        for peer in [*peers, *([self._own] if self._own else [])]:
            peer.socket.close()
        if self._joined >= 0:
            os.close(self._joined)
            self._joined = -1

    def _last(self) -> bool:
        """Return whether all others have left or were killed; none can join while the lock is held."""
        self._admit()
        poll = select.poll()
        for peer in self._peers:
            poll.register(peer.socket, 0)
        return self._knows_all and sum(bool(event & select.POLLHUP) for _, event in poll.poll(0)) == len(self._peers)
