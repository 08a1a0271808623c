"""The controller node: sensor packets in, one send-all packet out per slot. It does no I/O and reads no clock.

Which frames it takes as questions says `Questions`: those of the session that it is in, slot by slot, each once.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from hil.rig.loop import Loop
from hil.runtime.nodes import SEGMENT, before
from hil.runtime.nodes.controller_input import EverySample, NewestSample, controller_input
from transport.packets import EMPTY, MORE, SELECTIONS, ControlPacket, SensorPacket, decode, encode_control
from transport.wire import HELLO, echo

SILENCE_NS: Final = 1_000_000_000
"""A rig from which a packet came within this time keeps its controller."""

CANDIDATES: Final = 64
"""Sessions of which one may begin."""

NEAR: Final = 64
"""Slots that may be missing between two questions: so many hashes at most does one frame cost."""

FAR: Final = 4096
"""Slots that may be missing where a whole second has passed without a question."""


MOST_FRAMES: Final = 1024
"""Frames of a slot that wait for the one that closes it; a rig whose packets all arrive in one slot sends fewer."""


class Refusals(Struct):
    """Frames that a controller did not take.

    Attributes:
        malformed: no sensor packet of this loop.
        refused: of another session, of a slot that has not begun, or of one that is over.
        contradicted: other contents under the number of a frame that was taken: two senders.
    """

    malformed: int = 0
    refused: int = 0
    contradicted: int = 0


class Questions:
    """Judges sensor frames by their nonces and counters.

    A hello carries the nonce of a session that may begin; the session begins with the first slot whose nonce hashes to it. Slots
    only advance, and no other process can send for a slot that the rig has not reached: its nonce is not yet known. Frames of a
    slot wait until the one that closes it. A controller that starts in mid-run takes the session that it receives first.

    Args:
        counts: where refusals are counted.
        period_ns: sample period, ns.
    """

    def __init__(self, counts: Refusals, period_ns: int) -> None:
        self._counts, self._silence_ns = counts, max(SILENCE_NS, 3 * period_ns)
        self._candidates: dict[int, int] = {}  # how often each was named
        self._greeted = False  # the session began with a hello
        self.slot, self._nonce, self._taken_ns = -1, 0, -self._silence_ns
        self._closed = True
        self._frames: dict[int, tuple[SensorPacket, bytes]] = {}  # of the slot, by counter
        self._spoilt: set[int] = set()
        self.begun = False
        """Whether the frame taken last began a session."""
        self.running = False
        """Whether a session with nonces has begun."""

    def hello(self, nonce: int, now_ns: int) -> bool:
        """Return whether a hello is to be answered: not one of another session while one runs.

        Args:
            nonce: that it carries.
            now_ns: a monotonic clock, ns.
        """
        if self.running and self._greeted and now_ns - self._taken_ns < self._silence_ns:
            self._counts.refused += 1
            return False
        self._candidates[nonce] = self._candidates.get(nonce, 0) + 1
        if len(self._candidates) > CANDIDATES:
            del self._candidates[min(self._candidates, key=lambda named: self._candidates[named])]
        return True

    def take(self, packet: SensorPacket, data: bytes, now_ns: int) -> list[tuple[SensorPacket, bytes]] | None:
        """Take one frame; if it closes its slot, return all packets of the slot with their frames, in order; else None.

        If two frames have the same counter and other contents, neither sample counts: an empty frame is returned with the packet.

        Args:
            packet: decoded from the frame.
            data: the frame.
            now_ns: a monotonic clock, ns.
        """
        self.begun = False
        seq = packet.seq
        if seq != self.slot or packet.nonce != self._nonce:
            if not self._goes_on(seq, packet.nonce, now_ns) and not self._begins(seq, packet.nonce):
                self._counts.refused += 1
                return None
            self.slot, self._nonce, self._closed, self.running = seq, packet.nonce, False, True
            self._frames, self._spoilt = {}, set()
            self._candidates.clear()
        counter = packet.counter
        before_it = self._frames.get(counter)
        full = len(self._frames) >= MOST_FRAMES and packet.flags & MORE
        if before_it is not None or self._closed or full:
            if before_it is None:
                self._counts.contradicted += 1
            elif before_it[1] != data:
                self._counts.contradicted += 1
                self._spoilt.add(counter)
            return None
        self._taken_ns = now_ns
        self._frames[counter] = packet, data
        if packet.flags & MORE:
            return None
        self._closed = True
        if len(self._frames) == 1:
            return [(packet, data)]
        if max(self._frames) != counter:  # beyond the frame that closes the slot there is none of the rig's
            self._counts.contradicted += 1
            self._spoilt.update(number for number in self._frames if number > counter)
        return [(packet, b"" if number in self._spoilt else data) for number, (packet, data) in self._frames.items()]

    def _goes_on(self, seq: int, nonce: int, now_ns: int) -> bool:
        """Return whether a later slot of the session asks, by its nonce."""
        missing = seq - self.slot
        if not self.running or missing <= 0:
            return False
        if missing > NEAR and (missing > FAR or now_ns - self._taken_ns < self._silence_ns):
            return False
        first = seq - seq % SEGMENT
        if first > self.slot:
            return True  # the next chain begins
        for _ in range(missing):
            nonce = before(nonce)
        return nonce == self._nonce

    def _begins(self, seq: int, nonce: int) -> bool:
        """Return whether a slot begins a session: one of which a hello came, or, where no hello came, any."""
        if self._candidates:
            if not 0 <= seq <= NEAR:
                return False
            for _ in range(seq + 1):
                nonce = before(nonce)
            if nonce not in self._candidates:
                return False
            self._greeted = True
        elif self.running:
            return False
        else:
            self._greeted = False
        self.begun = True
        return True


_new: Final = tuple.__new__  # without the Python constructor: in five files 6 % of an interpreted virtual slot


class ControlNode:
    """Answers the frame that closes a slot, with the digest of the slot's sensor frames; tau is measured from time stamps.

    Where frames have nonces, `Questions` decides which of them are the rig's. A new session, whose time begins at 0, starts a
    fresh control law. So does a restart on the time line of faults; frames that come before its end are not received.

    Args:
        loop: the composed experiment.
    """

    def __init__(self, loop: Loop) -> None:
        self._set_loop(loop)
        self._input: NewestSample | EverySample = controller_input(loop)
        self._to_come = 0
        self._departed: tuple[int, str] | None = None  # of a controller that was changed or restarted
        self.counts = Refusals()
        self._questions = Questions(self.counts, self._period_ns)
        self._counter = self._hellos = 0

    def _set_loop(self, loop: Loop) -> None:
        self._loop = loop
        self._restarts = loop.rig.fault_schedule.restarts
        self._period_ns = loop.experiment.period_ns
        self._selection = SELECTIONS.index(loop.selection)
        self._zeros = ((0.0,) * len(loop.experiment.plant.inputs),) * loop.rows

    def change(self, loop: Loop, *, new_controller: bool) -> None:
        """Take a changed experiment of the same plant.

        Args:
            loop: the composed experiment.
            new_controller: whether its controller is another one, which starts without memory.
        """
        past = self._restarts[: self._to_come]
        self._set_loop(loop)
        self._to_come = sum(restart in past for restart in self._restarts)
        if new_controller:
            self._departed = self.departed
            self._input = controller_input(self._loop)
        else:
            self._input.change_reference(loop)

    def on_frame(self, data: bytes, now_ns: int = 0) -> bytes | None:
        """Take one frame from the link; return the answer when it closes its slot.

        Args:
            data: as it came.
            now_ns: a monotonic clock, ns; it counts only where another session wants to begin.
        """
        packet = decode(data)
        if not isinstance(packet, SensorPacket):
            self.counts.malformed += 1
            return None
        seq = packet.seq
        if seq == HELLO:
            return self._greet(packet, data, now_ns)
        if not packet.nonce and not self._questions.running:  # virtual time: no other process can send
            if self._restarts and self._down(seq):
                return None
            return self._answer(seq, 0) if self._keep(packet, seq) and not packet.flags & MORE else None
        frames = self._questions.take(packet, data, now_ns)
        if self._questions.begun:
            self._input, self._to_come, self._counter = controller_input(self._loop), 0, 0
        if (self._restarts and self._down(seq)) or frames is None:
            return None
        sound = [(packet, data) for packet, data in frames if data]
        for packet, _ in sound:
            if not self._keep(packet, packet.seq):
                return None
        return self._answer(seq, echo([data for _, data in sound]))

    @property
    def next_slot(self) -> int:
        """The slot behind the newest one of the session; 0 before it began."""
        return self._questions.slot + 1

    @property
    def departed(self) -> tuple[int, str] | None:
        """The slot in which the answers left the controller's table, and by how much; None if they did not."""
        return self._departed or (None if self._input.watch is None else self._input.watch.departed)

    def _keep(self, packet: SensorPacket, seq: int) -> bool:
        """Keep the sample of a packet; return False where it is not of this loop, or from the future."""
        if packet.flags & EMPTY:
            return True
        if packet.sample_ns > seq * self._period_ns or not self._input.take(packet):
            self.counts.malformed += 1  # two rigs on one link, or a rig with another plant
            return False
        return True

    def _greet(self, packet: SensorPacket, data: bytes, now_ns: int) -> bytes | None:
        if not packet.flags & EMPTY:
            self.counts.malformed += 1
            return None
        if not self._questions.hello(packet.nonce, now_ns):
            return None
        if not packet.nonce and self._input.sample_ns >= 0:
            self._input, self._to_come, self._counter = controller_input(self._loop), 0, 0
        self._hellos += 1
        nothing = ControlPacket(HELLO, -1, 0, 0, self._selection, self._zeros, echo([data]), self._hellos)
        return encode_control(nothing)

    def _answer(self, k: int, echoed: int) -> bytes | None:
        t_ns, sample_ns = k * self._period_ns, self._input.sample_ns
        tau = (t_ns - sample_ns) // self._period_ns if sample_ns >= 0 else 0
        if tau < 0:  # a slot from before the newest sample
            self.counts.malformed += 1
            return None
        rows = self._input.rows(k) if sample_ns >= 0 else self._zeros
        self._counter += 1
        return encode_control(_new(ControlPacket, (k, sample_ns, t_ns, tau, self._selection, rows, echoed, self._counter)))

    def _down(self, k: int) -> bool:
        """Forget everything where a restart has begun; return whether nothing is received in slot k."""
        while self._to_come < len(self._restarts) and self._restarts[self._to_come][0] <= k:
            self._departed = self.departed
            self._input, self._to_come = controller_input(self._loop), self._to_come + 1
        return any(first <= k < end for first, end in self._restarts)
