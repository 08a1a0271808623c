"""The controller node: sensor packets in, one send-all packet out per slot. It does no I/O and reads no clock."""

from __future__ import annotations

from hil.compose.loop import Loop
from transport.packets import EMPTY, MORE, SELECTIONS, ControlPacket, SensorPacket, decode, encode_control

HELLO = 0xFFFFFFFF  # seq of the rig's question "is anybody there", answered before slot 0 and never counted


class ControlNode:
    """Measures tau from time stamps and answers the frame that closes a slot, in its version, with its nonce.

    When a rig asks "is anybody there" again, the next session begins, whose time begins at 0, with a fresh control law.

    Args:
        loop: the composed experiment.
    """

    def __init__(self, loop: Loop) -> None:
        e = loop.experiment
        self._start = loop.start_controller
        self._controller = self._start()
        self._reference = loop.reference()
        self._period_ns = e.period_ns
        self._selection = SELECTIONS.index(loop.selection)
        self._zeros = ((0.0,) * len(e.plant.inputs),) * loop.rows
        self._width = len(e.plant.outputs) * loop.samples
        self._sample_ns = -1
        self._y: tuple[float, ...] = ()
        self.malformed = 0

    def hear(self, data: bytes) -> bytes | None:
        """Take one frame from the link; return the answer when it closes its slot."""
        packet = decode(data)
        if not isinstance(packet, SensorPacket):
            self.malformed += 1
            return None
        seq, flags, sample_ns, y = packet[:4]
        if seq == HELLO and self._sample_ns >= 0:
            self._sample_ns, self._y = -1, ()
            self._controller = self._start()
        if not flags & EMPTY:
            if len(y) != self._width:  # a rig with another plant
                self.malformed += 1
                return None
            if sample_ns >= self._sample_ns:  # an older sample than the newest is of no use
                self._sample_ns, self._y = sample_ns, y
        if flags & MORE:
            return None
        t_ns = seq * self._period_ns if seq != HELLO else 0
        if self._sample_ns < 0 or seq == HELLO:
            nothing = ControlPacket(seq, -1, t_ns, 0, self._selection, self._zeros, packet.nonce, version=packet.version)
            return encode_control(nothing)
        tau = (t_ns - self._sample_ns) // self._period_ns
        if tau < 0:  # a sample from the future: two rigs on one link, or not our rig
            self.malformed += 1
            return None
        rows = self._controller.rows(seq, tau, self._y, self._reference(seq))
        return encode_control(
            ControlPacket(seq, self._sample_ns, t_ns, tau, self._selection, rows, packet.nonce, version=packet.version)
        )
