"""Bare Unix sockets of Python, as a peer of our links: one system call sends a packet, one receives it."""

from __future__ import annotations

import socket
import struct
from typing import Final

from transport import Role
from transport.links.link import Closing, LinkCounters
from transport.links.traits import address_of

SCHEME: Final = "plain-unix"
"""Scheme of its URIs, ``plain-unix:<path>``, which the benchmark alone knows."""

_PATIENCE: Final = struct.pack("ll", 0, 50_000)  # seconds and microseconds that a receive waits, whatever it is asked


class PlainSocket(Closing):
    """One end of it; nothing is checked, and no process is kept out.

    Args:
        uri: with the path.
        role: the controller is there first and learns from the first packet where the rig is.
    """

    def __init__(self, uri: str, role: Role) -> None:
        self.uri, self.counters = uri, LinkCounters()
        path = address_of(uri)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(f"{path}.{role}")
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _PATIENCE)
        self._known = role == "rig"
        if self._known:
            self._socket.connect(f"{path}.controller")

    def send(self, packet: bytes) -> None:
        """Send one packet."""
        self._socket.send(packet)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next packet, None when none came.

        Args:
            timeout_s: 0 only looks; any other number waits for 50 ms.
        """
        try:
            if self._known:
                return self._socket.recv(256, 0 if timeout_s > 0 else socket.MSG_DONTWAIT)
            packet, rig = self._socket.recvfrom(256)
        except BlockingIOError:
            return None
        self._socket.connect(rig)
        self._known = True
        return packet

    def close(self) -> None:
        """Let go of it; may be called twice."""
        self._socket.close()
