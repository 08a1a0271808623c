"""Which of the frames that come back answers the slot, and what all the others are."""

from __future__ import annotations

from math import isfinite
from typing import Literal

from design.controllers import row_count
from hil.runtime.nodes.controller_node import HELLO
from hil.runtime.nodes.journal import Journal
from hil.runtime.nodes.wire import Wire
from transport.packets import SELECTIONS, ControlPacket, decode

FLOOD = 64
"""Frames thrown away in one slot that make a flood."""

LOGGED = 16
"""Late frames of one slot that the log keeps."""

REMEMBERED = 64
"""Slots for which a second answer is compared with the first one."""


Arrival = Literal["early", "in time", "late"]
"""When a frame came: before the question, before the deadline, after it."""


class Answers:
    """Takes frames from the link: one may answer the slot, the rest is counted by what it is.

    A frame is *malformed* (no control packet), *late* (the first answer to a slot that had none in time), or *foreign*: nobody
    was asked for it. A second answer that differs from the first, an answer to a slot that was not yet asked, and one without the
    nonce of its question show that somebody else answers too.

    Args:
        inputs: number m of inputs.
        d_max: largest age that the rows cover, samples.
        journal: takes records and events.
        wire: version and nonces of the session; an answer counts only if it has both.
    """

    def __init__(self, inputs: int, d_max: int, journal: Journal, wire: Wire) -> None:
        self._inputs, self._journal, self._wire = inputs, journal, wire
        self._row_counts = [row_count(selection, d_max) for selection in SELECTIONS]
        self._k = -1
        self._t_ns = 0
        self._nonce = 0
        self._thrown = self._logged = 0
        self._answered: dict[int, bytes | None] = {}  # of the last slots; None where nothing came in time
        self._packet: ControlPacket | None = None
        self.data = b""
        self.late = 0
        self.first_late: int | None = None
        self.malformed = self.foreign = self.refused = 0
        self.contradicted = self.flooded = False

    def open(self, t_ns: int, k: int) -> int:
        """Begin slot k, whose answer is to come; return its nonce.

        Args:
            t_ns: nominal time of the slot, ns.
            k: slot.
        """
        self._t_ns, self._k, self._packet = t_ns, k, None
        self._nonce = self._wire.nonce(k)
        self._answered.pop(k - REMEMBERED, None)
        self._thrown = self._logged = 0
        return self._nonce

    def take(self, data: bytes, when: Arrival = "in time") -> bool:
        """Take one frame; return whether it answers the open slot.

        Args:
            data: as it came.
            when: only what came between the question and the deadline answers it.
        """
        packet = decode(data)
        if not isinstance(packet, ControlPacket):
            self.malformed += 1
            self._throw_away()
            return False
        seq = packet.seq
        nonce = self._nonce if seq == self._k else self._wire.nonce(seq)
        if packet.nonce != nonce or packet.version != self._wire.version:
            self._contradict(self._stranger(packet), seq)
            self._foreign(seq, data)
            return False
        open_now = seq == self._k and self._packet is None
        if open_now and when == "in time":
            self._packet, self.data = packet, data
            self._answered[seq] = data
            return True
        if open_now and when == "late":
            self._late(seq, data)  # the slot is not booked as missing before it is closed
        elif seq in self._answered:
            if self._answered[seq] is None:
                del self._answered[seq]
                self._late(seq, data)
                return False
            if data != self._answered[seq]:
                self._contradict(f"slot {seq} was answered twice, differently", seq)
            self._foreign(seq, data)
        elif seq != HELLO and (seq > self._k or open_now):
            self._contradict(f"slot {seq} was answered before it was asked", seq)
            self._foreign(seq, data)
        else:
            self._foreign(seq, data)
        return False

    def close(self) -> ControlPacket | None:
        """End the slot; return its answer, None if none came in time."""
        if self._packet is None:
            self.late += 1
            self._answered[self._k] = None
            if self.first_late is None:
                self.first_late = self._k
                self._journal.event(
                    self._t_ns, "late", "no control packet before the deadline: taken as lost", tick=self._k, severity="warning"
                )
        return self._packet

    def usable(self, packet: ControlPacket) -> bool:
        """Return whether the rows of an answer fit the loop and are finite; count it as refused if not.

        Args:
            packet: an answer in time.
        """
        expected, rows = self._row_counts[packet.selection], packet.rows
        if len(rows) == expected and len(rows[0]) == self._inputs:
            if isfinite(sum(map(sum, rows))):
                return True
            fault = "a row is not finite"
        else:
            shape = f"{len(rows)} rows of {len(rows[0]) if rows else 0}"
            fault = f"{shape}, expected {expected} of {self._inputs} for {SELECTIONS[packet.selection]!r}"
        self.refused += 1
        if self.refused == 1:
            self._journal.event(self._t_ns, "refused", f"control packet refused: {fault}", tick=self._k, severity="error")
        return False

    def _stranger(self, packet: ControlPacket) -> str:
        if packet.version != self._wire.version:
            hint = "; a controller of version 1 needs ?version=1 behind the link's address" if packet.version == 1 else ""
            return f"slot {packet.seq} was answered in wire version {packet.version}, asked in version {self._wire.version}{hint}"
        return f"slot {packet.seq} was answered without the nonce of its question"

    def _late(self, seq: int, data: bytes) -> None:
        if self._logged < LOGGED:
            self._logged += 1
            self._journal.late(self._t_ns, seq, data)

    def _foreign(self, seq: int, data: bytes) -> None:
        self.foreign += 1
        if seq != HELLO:
            self._late(seq, data)
        self._throw_away()

    def _throw_away(self) -> None:
        self._thrown += 1
        if self._thrown == FLOOD and not self.flooded:
            self.flooded = True
            self._journal.event(
                self._t_ns, "flood", f"{FLOOD} frames that answer no question came within slot {self._k}: they are thrown away "
                "and counted, and the answer may be lost among them", tick=self._k, severity="error",
            )  # fmt: skip

    def _contradict(self, what: str, seq: int) -> None:
        if not self.contradicted:
            self.contradicted = True
            self._journal.event(
                self._t_ns, "second controller", f"second controller on the link: {what}", tick=seq, severity="error"
            )

    def outcome(self) -> dict[str, int | None]:
        """Return the counters that the summary needs."""
        return {
            "late": self.late,
            "first_late_tick": self.first_late,
            "malformed": self.malformed,
            "foreign": self.foreign,
            "refused": self.refused,
        }
