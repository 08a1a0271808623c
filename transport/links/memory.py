"""The link inside one process: two deques, as fast as a link can be, for virtual time and for tests.

The scheme ``local:`` has nothing to open: the controller runs in the rig's own process.
"""

from __future__ import annotations

from collections import deque
from threading import Condition
from typing import Never

from transport.links import Closing, LinkCounters, Role, TransportError


def open_local(uri: str, role: Role) -> Never:
    """The controller runs in the rig's process (`hil run --link local:`); no end is left to open by a URI.

    Raises:
        TransportError: always; it says what to use instead.
    """
    raise TransportError(
        f"link {uri!r}: the controller runs in the rig's own process, and no {role} can be opened by name; "
        "use can:hil:rig0 between processes"
    )


QUEUE_LIMIT = 256
"""Packets that wait at one end; what comes on top is dropped and counted by the sender."""


class MemoryLink(Closing):
    """One end of an in-process pair; make both with `memory_pair`. Ends may live in different threads."""

    def __init__(self) -> None:
        self.uri = "memory:"
        self.counters = LinkCounters()
        self.peer: MemoryLink | None = None
        self._queue: deque[bytes] = deque()
        self._arrived = Condition()
        self._waiting = self._closed = False

    def send(self, packet: bytes) -> None:
        peer = self.peer
        if self._closed or peer is None or peer._closed or len(peer._queue) >= QUEUE_LIMIT:
            self.counters.dropped += 1
            return
        peer._queue.append(packet)
        self.counters.sent += 1
        # Looked at after the append: the receiver raises the flag before it looks at the queue a second time.
        if peer._waiting:
            with peer._arrived:
                peer._arrived.notify()

    def receive(self, timeout_s: float) -> bytes | None:
        queue = self._queue
        if not queue and timeout_s > 0 and not self._closed:
            with self._arrived:
                self._waiting = True
                if not queue and not self._closed:
                    self._arrived.wait(timeout_s)
                self._waiting = False
        if not queue or self._closed:
            return None
        self.counters.received += 1
        return queue.popleft()

    def close(self) -> None:
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()


def memory_pair() -> tuple[MemoryLink, MemoryLink]:
    """Return the rig's and the controller's end of a new in-process link.

    >>> rig, controller = memory_pair()
    >>> rig.send(b"y")
    >>> controller.receive(0), rig.receive(0)
    (b'y', None)
    """
    rig, controller = MemoryLink(), MemoryLink()
    rig.peer, controller.peer = controller, rig
    return rig, controller


def open_memory(uri: str, role: Role) -> Never:
    """Virtual time only: both ends lie in one process, and cannot be opened by a URI.

    Raises:
        TransportError: always; it names the link to use instead.
    """
    raise TransportError(
        f"link {uri!r}: lives inside one process and cannot be opened by name as {role}; "
        "use can:hil:rig0 between processes, --clock virtual, or transport.memory_pair()"
    )
