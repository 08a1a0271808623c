"""Which frames a controller takes as questions: those of the session that it is in, slot by slot, each once."""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from hil.runtime.nodes.wire import SEGMENT, before
from transport.packets import MORE, SensorPacket

SILENCE_NS: Final = 1_000_000_000
"""A rig from which a packet came within this time keeps its controller."""

CANDIDATES: Final = 64
"""Sessions of which one may begin."""

NEAR: Final = 64
"""Slots that may be missing between two questions: so many hashes at most does one frame cost."""

FAR: Final = 4096
"""Slots that may be missing where a whole second has passed without a question."""


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

    A hello names a session that may begin; it begins with the first slot whose nonce the name foretold. Its
    slots only go on; none can be asked for that the rig has not reached, as its nonce is not known yet. Frames of a slot
    wait until the one that closes it. A controller that starts in mid-run takes the session that it receives first.

    Args:
        counts: where refusals are counted.
        period_ns: sample period, ns.
    """

    def __init__(self, counts: Refusals, period_ns: int) -> None:
        self._counts, self._silence_ns = counts, max(SILENCE_NS, 3 * period_ns)
        self._candidates: dict[int, int] = {}  # how often each was named
        self._greeted = False  # the session began with a hello
        self._slot, self._nonce, self._taken_ns = -1, 0, -self._silence_ns
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
            nonce: what it names.
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
        """Take one frame; return those of its slot where it closes it, in their order, else None.

        Of two with one number and other contents neither's sample counts: the second of the pair that is given back is empty.

        Args:
            packet: what the frame says.
            data: its bytes.
            now_ns: a monotonic clock, ns.
        """
        self.begun = False
        seq = packet.seq
        if seq != self._slot or packet.nonce != self._nonce:
            if not self._goes_on(seq, packet.nonce, now_ns) and not self._begins(seq, packet.nonce):
                self._counts.refused += 1
                return None
            self._slot, self._nonce, self._closed, self.running = seq, packet.nonce, False, True
            self._frames, self._spoilt = {}, set()
            self._candidates.clear()
        counter = packet.counter
        before_it = self._frames.get(counter)
        if before_it is not None or self._closed:
            if before_it is None or before_it[1] != data:
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
        missing = seq - self._slot
        if not self.running or missing <= 0:
            return False
        if missing > NEAR and (missing > FAR or now_ns - self._taken_ns < self._silence_ns):
            return False
        first = seq - seq % SEGMENT
        if first > self._slot:
            return True  # the next chain begins
        for _ in range(missing):
            nonce = before(nonce)
        return nonce == self._nonce

    def _begins(self, seq: int, nonce: int) -> bool:
        """Return whether a slot begins a session: one that was named, or, where none is known, any."""
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
