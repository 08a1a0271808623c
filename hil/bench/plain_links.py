"""The plainest links there are, as peers of ours: bare Unix sockets, and zenoh with the threads that it starts."""

from __future__ import annotations

import socket
import struct
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Final

from transport import Role
from transport.links import Closing, LinkCounters
from transport.links.traits import address_of
from transport.links.zenoh_link import config

if TYPE_CHECKING:
    import zenoh


UNIX: Final = "plain-unix"
"""Scheme of its URIs, ``plain-unix:<path>``, which the benchmark alone knows."""

_PATIENCE: Final = struct.pack("ll", 0, 50_000)  # seconds and microseconds that a receive waits, whatever it is asked


class PlainSocket(Closing):
    """One end of two bare sockets: one system call sends a packet, one receives it. Nothing is checked, no process kept out.

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


ZENOH: Final = "plain-zenoh"
"""Scheme of its URIs, ``plain-zenoh:<endpoint>``, which the benchmark alone knows."""


class PlainZenoh(Closing):
    """One end of a callback into a queue: no queue limit, no authentication.

    Args:
        uri: with the endpoint.
        role: the rig listens, the controller connects.
    """

    def __init__(self, uri: str, role: Role) -> None:
        import zenoh

        self.uri, self.counters = uri, LinkCounters()
        self._queue: SimpleQueue[bytes] = SimpleQueue()
        self._session = zenoh.open(config(role, address_of(uri), {}))
        sends, receives = ("sensor", "control") if role == "rig" else ("control", "sensor")
        publisher = self._session.declare_publisher(
            f"hil/plain/{sends}", express=True, priority=zenoh.Priority.REAL_TIME, congestion_control=zenoh.CongestionControl.DROP
        )
        self._put = publisher.put
        self._session.declare_subscriber(f"hil/plain/{receives}", zenoh.handlers.Callback(self._take, indirect=False))

    def _take(self, sample: zenoh.Sample) -> None:
        self._queue.put(sample.payload.to_bytes())

    def send(self, packet: bytes) -> None:
        """Send one packet."""
        self._put(packet)
        self.counters.sent += 1

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next packet, None when none came in time.

        Args:
            timeout_s: how long to wait, s.
        """
        try:
            packet = self._queue.get(timeout_s > 0, timeout_s if timeout_s > 0 else None)
        except Empty:
            return None
        self.counters.received += 1
        return packet

    def close(self) -> None:
        """Let go of it; may be called twice."""
        self._session.close()  # type: ignore[no-untyped-call]
