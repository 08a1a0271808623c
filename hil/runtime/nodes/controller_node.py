"""The controller node: sensor packets in, one send-all packet out per slot. It does no I/O and reads no clock."""

from __future__ import annotations

from functools import partial

from hil.compose.loop import Loop
from hil.compose.time_line import time_line
from hil.runtime.nodes.heard import heard_by
from transport.packets import EMPTY, MORE, SELECTIONS, ControlPacket, SensorPacket, decode, encode_control

HELLO = 0xFFFFFFFF  # seq of the rig's question "is anybody there", answered before slot 0 and never counted

_new = tuple.__new__  # a packet without its Python constructor


class ControlNode:
    """Answers the frame that closes a slot, in its version, with its nonce; tau is measured from time stamps.

    When a rig asks "is anybody there" again, the next session begins, whose time begins at 0, with a fresh control law. At a
    restart on the time line of faults everything is forgotten too, and frames until its end are not heard.

    Args:
        loop: the composed experiment.
    """

    def __init__(self, loop: Loop) -> None:
        self._begin = partial(heard_by, loop)
        self._heard = self._begin()
        self._restarts, self._to_come = time_line(loop.experiment).restarts, 0
        self._period_ns = loop.experiment.period_ns
        self._selection = SELECTIONS.index(loop.selection)
        self._zeros = ((0.0,) * len(loop.experiment.plant.inputs),) * loop.rows
        self.malformed = 0

    def hear(self, data: bytes) -> bytes | None:
        """Take one frame from the link; return the answer when it closes its slot."""
        packet = decode(data)
        if not isinstance(packet, SensorPacket):
            self.malformed += 1
            return None
        seq, flags = packet.seq, packet.flags
        hello = seq == HELLO
        if hello:
            t_ns, ahead = 0, False
            if self._heard.sample_ns >= 0:
                self._heard, self._to_come = self._begin(), 0
        else:
            if self._restarts and self._down(seq):
                return None
            t_ns = seq * self._period_ns
            ahead = packet.sample_ns > t_ns  # a sample from the future
        heard = self._heard
        if not flags & EMPTY and (ahead or not heard.take(packet)):
            self.malformed += 1  # two rigs on one link, or a rig with another plant
            return None
        if flags & MORE:
            return None
        sample_ns = heard.sample_ns
        if sample_ns < 0 or hello:
            nothing = ControlPacket(seq, -1, t_ns, 0, self._selection, self._zeros, packet.nonce, version=packet.version)
            return encode_control(nothing)
        tau = (t_ns - sample_ns) // self._period_ns
        if tau < 0:  # a slot from before the newest sample
            self.malformed += 1
            return None
        rows = heard.rows(seq)
        answer = (seq, sample_ns, t_ns, tau, self._selection, rows, packet.nonce, 0, b"", packet.version)
        return encode_control(_new(ControlPacket, answer))

    def _down(self, k: int) -> bool:
        """Forget everything where a restart has begun; return whether nothing is heard in slot k."""
        while self._to_come < len(self._restarts) and self._restarts[self._to_come][0] <= k:
            self._heard, self._to_come = self._begin(), self._to_come + 1
        return any(first <= k < end for first, end in self._restarts)
