"""One connection of the mesh: what it carries, and what it missed."""

from __future__ import annotations

import socket
from contextlib import suppress
from socket import MSG_NOSIGNAL
from struct import Struct
from typing import Final

HEAD: Final = Struct("<dH")
"""Time stamp, s; datagrams lost before this one."""

_STAMP: Final = Struct("@ll")
_STAMP_SPACE: Final = socket.CMSG_SPACE(_STAMP.size)
_SO_TIMESTAMPNS: Final = 35  # <asm-generic/socket.h>; the socket module does not name it
_SEND_BUFFER: Final = 212_992  # the most that Linux grants without root; holds more than QUEUE_LIMIT, see the tests


def _stamp_what_waits(connection: socket.socket) -> None:
    """Have the kernel stamp the datagram that came before this socket asked for stamps.

    It stamps such a datagram when it is first looked at: later than what others send meanwhile, which would be read first.
    Only the first: several that came before are in turn with those of others who were let in at the same time.
    """
    with suppress(BlockingIOError):
        connection.recvmsg(1, _STAMP_SPACE, socket.MSG_PEEK)


class Peer:
    """One connection, and how many datagrams it missed since the last one that got through."""

    __slots__ = ("_send", "missed", "socket")

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        with suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        with suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            _stamp_what_waits(connection)
        self.socket = connection
        self._send = connection.send
        self.missed = 0

    def offer(self, datagram: bytes) -> None:
        """Send, or raise `OSError`; never wait."""
        if not self.missed:
            self._send(datagram, MSG_NOSIGNAL)
            return
        told = min(self.missed, 0xFFFF)
        self._send(HEAD.pack(HEAD.unpack_from(datagram)[0], told) + datagram[HEAD.size :], MSG_NOSIGNAL)
        self.missed -= told

    def arrival_ns(self) -> int:
        """Return when the kernel took the datagram that waits here, ns; -1 where nothing says so: it is read at once."""
        try:
            _, said, _, _ = self.socket.recvmsg(1, _STAMP_SPACE, socket.MSG_PEEK)
        except OSError:
            return -1
        for level, kind, data in said:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) == _STAMP.size:
                seconds, nanoseconds = _STAMP.unpack(data)
                return int(seconds) * 1_000_000_000 + int(nanoseconds)
        return -1
