"""The plainest link over zenoh, as a peer of ours: a callback into a queue, and the threads that zenoh starts by itself."""

from __future__ import annotations

from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Final

from transport import Role
from transport.links.link import Closing, LinkCounters
from transport.links.traits import address_of
from transport.links.zenoh_link import config

if TYPE_CHECKING:
    import zenoh

SCHEME: Final = "plain-zenoh"
"""Scheme of its URIs, ``plain-zenoh:<endpoint>``, which the benchmark alone knows."""


class PlainZenoh(Closing):
    """One end of it; no queue limit, no authentication.

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
