"""``local:``: the controller in the rig's own process, so that nothing but its computing lies between question and answer."""

from __future__ import annotations

from collections import deque

from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.time.clock import monotonic_ns
from transport.links.link import Closing, LinkCounters


class LocalLink(Closing):
    """The rig's end of a link whose other end is a controller node: a question is answered while it is sent.

    Args:
        node: the controller node.
    """

    def __init__(self, node: ControlNode) -> None:
        self.uri = "local:"
        self.counters = LinkCounters()
        self._node = node
        self._answers: deque[bytes] = deque()
        self._closed = False

    def send(self, packet: bytes) -> None:
        """Let the node take a frame, and keep what it answers."""
        if self._closed:
            self.counters.dropped += 1
            return
        self.counters.sent += 1
        answer = self._node.on_frame(packet, monotonic_ns())
        if answer is not None:
            self._answers.append(answer)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the answer, None if there is none: it was given in :meth:`send`, so that waiting brings nothing.

        Args:
            timeout_s: not waited.
        """
        if self._closed or not self._answers:
            return None
        self.counters.received += 1
        return self._answers.popleft()

    def close(self) -> None:
        """Let go of it; may be called twice."""
        self._closed = True
