"""Which of the frames that come back answers the slot, and what all the others are."""

from __future__ import annotations

from collections import OrderedDict
from math import isfinite

from design.controllers import row_count
from hil.runtime.nodes.controller_node import HELLO
from hil.runtime.nodes.journal import Journal
from transport.packets import SELECTIONS, ControlPacket, decode

FLOOD = 64
"""Frames thrown away in one slot that make a flood."""

LOGGED = 16
"""Late frames of one slot that the log keeps."""

REMEMBERED = 64
"""Slots for which a second answer is compared with the first one."""


class Answers:
    """Takes frames from the link: one may answer the slot, the rest is counted by what it is.

    A frame is *malformed* (no control packet), *late* (the first answer to a slot that had none in time), or *foreign*: nobody
    was asked for it. A second answer that differs from the first, and an answer to a slot that was not yet asked, show that
    somebody else answers too.

    Args:
        inputs: number m of inputs.
        d_max: largest age that the rows cover, samples.
        journal: takes records and events.
    """

    def __init__(self, inputs: int, d_max: int, journal: Journal) -> None:
        self._inputs, self._journal = inputs, journal
        self._row_counts = [row_count(selection, d_max) for selection in SELECTIONS]
        self._k = -1
        self._t_ns = 0
        self._thrown = self._logged = 0
        self._answered: OrderedDict[int, bytes] = OrderedDict()
        self._missing: OrderedDict[int, bytes] = OrderedDict()
        self._packet: ControlPacket | None = None
        self.data = b""
        self.late = 0
        self.first_late: int | None = None
        self.malformed = self.foreign = self.refused = 0
        self.contradicted = self.flooded = False

    def open(self, t_ns: int, k: int) -> None:
        """Begin slot k, whose answer is to come.

        Args:
            t_ns: nominal time of the slot, ns.
            k: slot.
        """
        self._t_ns, self._k, self._packet = t_ns, k, None
        self._thrown = self._logged = 0

    def take(self, data: bytes, in_time: bool = True) -> bool:
        """Take one frame; return whether it answers the open slot.

        Args:
            data: as it came.
            in_time: whether it came before the deadline; a later one never answers.
        """
        packet = decode(data)
        if not isinstance(packet, ControlPacket):
            self.malformed += 1
            self._throw_away()
            return False
        seq = packet.seq
        if seq == self._k and self._packet is None and in_time:
            self._packet, self.data = packet, data
            _remember(self._answered, seq, data)
            return True
        if seq == self._k and self._packet is None:
            self._late(seq, data)  # the slot is not booked as missing before it is closed
        elif seq in self._missing:
            del self._missing[seq]
            self._late(seq, data)
        elif seq in self._answered:
            if data != self._answered[seq]:
                self._contradict(f"slot {seq} was answered twice, differently", seq)
            self._foreign(seq, data)
        elif seq != HELLO and seq > self._k:
            self._contradict(f"slot {seq} was answered before it was asked", seq)
            self._foreign(seq, data)
        else:
            self._foreign(seq, data)
        return False

    def close(self) -> ControlPacket | None:
        """End the slot; return its answer, None if none came in time."""
        if self._packet is None:
            self.late += 1
            _remember(self._missing, self._k, b"")
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
        fault = None
        if len(rows) != expected or len(rows[0]) != self._inputs:
            shape = f"{len(rows)} rows of {len(rows[0]) if rows else 0}"
            fault = f"{shape}, expected {expected} of {self._inputs} for {SELECTIONS[packet.selection]!r}"
        elif not isfinite(sum(map(sum, rows))):
            fault = "a row is not finite"
        if fault is None:
            return True
        self.refused += 1
        if self.refused == 1:
            self._journal.event(self._t_ns, "refused", f"control packet refused: {fault}", tick=self._k, severity="error")
        return False

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


def _remember(kept: OrderedDict[int, bytes], seq: int, data: bytes) -> None:
    kept[seq] = data
    if len(kept) > REMEMBERED:
        kept.popitem(last=False)
