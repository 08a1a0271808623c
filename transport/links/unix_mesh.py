"""Processes of one user that receive each other's datagrams, over Unix sockets, without a broker.

A newcomer changes a shared mark, see `transport.links.mesh_members`; a sender that sees the mark changed lets the newcomers in
and sends to them too. Hence everyone receives whatever is sent after it joined. The mark is read behind the sending, which who
waits for the datagram does not wait for.

The kernel queues up to `QUEUE_LIMIT` datagrams from each sender at each receiver. Beyond that a datagram is lost for this
receiver only: the sender counts it as dropped, and the next datagram that gets through carries to the receiver how many it
missed. No participant ever waits for another, be it slow, stopped or dead.

A datagram begins with `mesh_members.HEAD`: the time it was sent, for who logs it, or 0 for the time at which the kernel of who
logs it took it, and the number of datagrams missed before it, which is the mesh's to fill in. A receiver merges its senders by
the instant at which its own kernel took each datagram: what a sender says of the time decides nothing, or who says 0 would
always come first.
"""

from __future__ import annotations

import select
import socket
from collections.abc import Sequence
from contextlib import suppress
from errno import ENOBUFS
from pathlib import Path
from typing import Final

from transport.links import Closing
from transport.links.mesh_members import HEAD_BYTES, Members, Peer

QUEUE_LIMIT: Final = 256
"""So many datagrams of up to 80 bytes wait at least at a receiver, from each sender."""

POLLS: Final = 400
"""How often a short wait looks for an answer before it sleeps: about 200 us."""
_MOST_IN_VAIN: Final = 8

_COARSE_S: Final = 0.05  # epoll rounds up to milliseconds: good enough for a wait as long as this


class Mesh(Closing):
    """One participant.

    Args:
        directory: where the participants' sockets are; made if missing, removed by the last one to leave.
        echo: receive one's own datagrams too (those given to `echo`).
        looks: look for an answer before a short wait sleeps; not where another thread of this process sends it, which would
            wait for the interpreter meanwhile.
        stamped: give datagrams without a time the kernel's.

    Attributes:
        dropped: datagrams this participant could not hand to another one whose queue was full.
        lost: datagrams others could not hand to this one.

    Raises:
        TransportError: no such directory can be had, it belongs to another user, or the disk or the descriptors are used up.
    """

    def __init__(self, directory: Path, *, echo: bool = False, looks: bool = True, stamped: bool = False) -> None:
        self.directory = directory
        self.dropped = self.lost = 0
        self._looks = looks
        self._asked = False  # whether it has looked for newcomers since it last received; sending looks for them
        self._rest = self._vain = 0  # short waits that will not look first; looks in vain, one after the other
        self._members = Members(directory, echo=echo, stamped=stamped)

    def send(self, datagram: bytes, wait_s: float = 0.0) -> bool:
        """Send to everyone.

        Args:
            datagram: `HEAD` and up to 70 bytes.
            wait_s: how long to wait for room in a full queue, s.

        Returns:
            Whether a participant took it, or there is none; False if none of them had room.
        """
        members = self._members
        peers = members.peers
        taken, full = self._offer(peers, datagram, wait_s)
        self._asked = True
        if members.unseen():  # looked at when the others have it already, who wait for it
            members.admit()
        if members.peers is not peers:
            late, full_too = self._offer([peer for peer in members.peers if peer not in peers], datagram, wait_s)
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
            unread = bool(peer.socket.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT))
        except ConnectionResetError:
            unread = True  # it left without reading all of ours; its own may still be here
        except OSError:
            unread = False
        self._members.remove(peer, unread=unread)
        return True

    def echo(self, datagram: bytes) -> None:
        """Hand a datagram to oneself."""
        own = self._members.own
        if own is not None:
            try:
                own.offer(datagram)
            except OSError:
                self.dropped += 1

    def receive(self, timeout_s: float | None) -> bytes | None:
        """Return the next datagram, of all that wait the one that arrived first, or None.

        None may come before the time is up, when nothing but a coming or going happened.

        Args:
            timeout_s: s; None waits for ever.
        """
        members, epoll = self._members, self._members.epoll
        ready: list[tuple[int, int]] = []
        if self._asked and (timeout_s is None or timeout_s > 0) and members.lone is not None:
            self._asked = False  # a lone participant, and no newcomer: nothing could come before what the wait reads
        else:
            ready = epoll.poll(0)
        if not ready and (timeout_s is None or timeout_s > 0):
            found = self._wait(timeout_s)
            if isinstance(found, bytes):
                return found
            ready = found
        while ready:
            descriptor = ready[0][0] if len(ready) == 1 else min(ready, key=self._time)[0]
            peer = members.sources.get(descriptor)
            if peer is None:
                members.admit()
            else:
                datagram = self._read(peer)
                if datagram is not None:
                    return datagram
            ready = epoll.poll(0)
        return None

    def _read(self, peer: Peer, wait: bool = False) -> bytes | None:
        """Return the next datagram of a participant, None if there is none."""
        try:
            datagram = peer.await_one() if wait else peer.read()
        except OSError:  # another thread took it, or the other end has left: what it sent is read next
            return None
        if len(datagram) >= HEAD_BYTES:
            self.lost += datagram[8] | datagram[9] << 8
            return datagram
        if not datagram:
            self._members.remove(peer, unread=False)
        return None

    def _wait(self, timeout_s: float | None) -> bytes | list[tuple[int, int]]:
        """Wait; return the datagram that came, or what epoll has, [] if nothing came."""
        if timeout_s is not None and timeout_s < _COARSE_S:
            return (self._look() if self._looks else []) or self._sleep(timeout_s)
        lone = self._members.lone
        if lone is not None:  # asleep in the call that reads: a newcomer's first datagrams may wait for 50 ms
            found = self._read(lone, wait=True)
            if found is not None or self._members.lone is not lone:
                return found or []
            timeout_s = None if timeout_s is None else timeout_s - _COARSE_S
        return self._members.epoll.poll(timeout_s)

    def _look(self) -> bytes | list[tuple[int, int]]:
        """Look for an answer without sleep; return what came, or what epoll has, [] if nothing came.

        Who waits briefly waits for an answer, and waking up from a sleep would double its way. Where looking does not help, as
        when both ends share one CPU, it is given up, and tried again ever more rarely.
        """
        if self._rest:
            self._rest -= 1
            return []
        epoll, lone = self._members.epoll, self._members.lone
        for _ in range(POLLS):
            # A lone participant is read without asking epoll whether it can be: none but a newcomer could have come first.
            found = epoll.poll(0) if lone is None else self._read(lone)
            if found:
                self._vain = 0
                return found
        self._vain += 1
        if self._vain >= _MOST_IN_VAIN:
            self._rest = 1 << min(self._vain, 14)
        return []

    def _sleep(self, timeout_s: float) -> list[tuple[int, int]]:
        """Wait more exactly than epoll does, which counts milliseconds."""
        epoll = self._members.epoll
        with suppress(ValueError):  # more than 1024 open files
            if not select.select((epoll,), (), (), timeout_s)[0]:
                return []
            timeout_s = 0.0
        return epoll.poll(timeout_s)

    def _time(self, event: tuple[int, int]) -> int:
        peer = self._members.sources.get(event[0])
        if peer is None:
            return -1  # newcomers first
        return peer.arrival_ns()

    def fileno(self) -> int:
        """Return a descriptor that is readable while something waits; -1 after `close`."""
        return -1 if self._members.closed else self._members.epoll.fileno()

    @property
    def participants(self) -> int:
        """Number of participants, this one included, as far as known."""
        return len(self._members.peers) + 1

    @property
    def refused(self) -> int:
        """How often a newcomer found no free file descriptor here. It is let in when one is free again."""
        return self._members.refused

    def close(self) -> None:
        """Leave; what was sent stays readable for the others. The last one alive clears the directory away."""
        self._members.leave()
