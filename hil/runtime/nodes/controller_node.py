"""The controller node: sensor packets in, one send-all packet out per slot. It does no I/O and reads no clock."""

from __future__ import annotations

from collections.abc import Callable

from design.controllers import FromSamples, Known, Rows, RunningController
from hil.compose.loop import Loop
from hil.compose.time_line import time_line
from hil.runtime.nodes.assembly import Assembly, from_samples
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
        self._memory: Callable[[], _Newest | _Several] = lambda: _Several(loop) if loop.experiment.nodes else _Newest(loop)
        self._heard = self._memory()
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
        if seq == HELLO and self._heard.sample_ns >= 0:
            self._heard, self._to_come = self._memory(), 0
        if self._restarts and seq != HELLO and self._down(seq):
            return None
        if not flags & EMPTY and not self._heard.take(packet):
            self.malformed += 1  # a rig with another plant
            return None
        if flags & MORE:
            return None
        t_ns, sample_ns = seq * self._period_ns if seq != HELLO else 0, self._heard.sample_ns
        if sample_ns < 0 or seq == HELLO:
            nothing = ControlPacket(seq, -1, t_ns, 0, self._selection, self._zeros, packet.nonce, version=packet.version)
            return encode_control(nothing)
        tau = (t_ns - sample_ns) // self._period_ns
        if tau < 0:  # a sample from the future: two rigs on one link, or not our rig
            self.malformed += 1
            return None
        rows = self._heard.rows(seq, tau)
        answer = (seq, sample_ns, t_ns, tau, self._selection, rows, packet.nonce, 0, b"", packet.version)
        return encode_control(_new(ControlPacket, answer))

    def _down(self, k: int) -> bool:
        """Forget everything where a restart has begun; return whether nothing is heard in slot k."""
        while self._to_come < len(self._restarts) and self._restarts[self._to_come][0] <= k:
            self._heard, self._to_come = self._memory(), self._to_come + 1
        return any(first <= k < end for first, end in self._restarts)


class _Newest:
    """One sensor node: an older sample than the newest is of no use."""

    def __init__(self, loop: Loop) -> None:
        running = loop.start_controller()
        if isinstance(running, FromSamples):
            raise TypeError(f"{type(running).__name__}: takes samples of named nodes")  # compose refuses it before
        self._controller: RunningController = running
        self._reference = loop.reference()
        self._width = len(loop.experiment.plant.outputs) * loop.samples
        self.sample_ns = -1
        self._y: tuple[float, ...] = ()

    def take(self, packet: SensorPacket) -> bool:
        """Keep a sample; return False if it is not of this loop."""
        y = packet.y
        if len(y) != self._width:
            return False
        if packet.sample_ns >= self.sample_ns:
            self.sample_ns, self._y = packet.sample_ns, y
        return True

    def rows(self, k: int, tau: int) -> Rows:
        """Return what the control law says."""
        return self._controller.rows(k, tau, self._y, self._reference(k))


class _Several:
    """Several sensor nodes: what each of them has sent, as far back as the control law looks."""

    def __init__(self, loop: Loop) -> None:
        inputs, outputs = len(loop.experiment.plant.inputs), len(loop.experiment.plant.outputs)
        nothing = ((0.0,) * inputs,) * loop.rows
        self._controller = from_samples(loop.start_controller(), loop.sensors, outputs, nothing)
        self._assembly = Assembly(loop.sensors, self._controller.memory)
        self._reference = loop.reference()
        self._period_ns = loop.experiment.period_ns
        self.sample_ns = -1

    def take(self, packet: SensorPacket) -> bool:
        """Keep the samples of a packet; return False if it is not of this loop."""
        slot, rest = divmod(packet.sample_ns, self._period_ns)
        late = packet.seq != HELLO and slot > packet.seq  # from the future
        if rest or slot < 0 or late or not self._assembly.fits(packet.node, packet.nodes, packet.samples, len(packet.y)):
            return False
        self._assembly.take(packet.node, slot, packet.y)
        self.sample_ns = max(self.sample_ns, packet.sample_ns)
        return True

    def rows(self, k: int, tau: int) -> Rows:
        """Return what the control law says."""
        return self._controller.rows(k, Known(self._assembly.known(k), self._reference(k)))
