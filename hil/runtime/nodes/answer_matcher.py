"""Finds the control frame that answers the slot, and counts all other frames by their kind."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress, product
from math import isinf, isnan
from typing import Final, Literal

from design.controllers import row_count
from hil.log import REFUSED
from hil.runtime.nodes.journal import Journal
from transport.packets import SELECTIONS, ControlPacket, decode
from transport.wire import HELLO, echo

FLOOD: Final = 64
FLOOD_NS: Final = 50_000_000
"""So many frames thrown away within so long (or one slot, if that is longer) make a flood."""

LOGGED: Final = 16
"""Late frames of one slot that the log keeps."""

REMEMBERED: Final = 1024
"""Slots for which a second answer is compared with the first one, and a late one is known: a second of stall at 1 kHz."""

SAMPLES: Final = 1024
"""Samples that are known to have been sent."""

Arrival = Literal["in time", "late"]
"""When a frame came: before the deadline, or after it."""

MOST_LOST: Final = 6
"""Sensor frames of a slot up to which an answer to only some of them is distinguished from an answer to forged frames."""


class AnswerMatcher:
    """Takes frames from the link: one may answer the slot, all others are counted by their kind.

    A frame is *malformed* (no control packet), *late* (the first answer to a slot that had none in time), or *foreign* (any other
    that is no answer). Four kinds of foreign frame show that another process sends on the link: a second answer that differs from
    the first, an answer to a slot that has not begun, one whose echo is not that of the sensor frames, and one to a sample that
    was never sent.

    Args:
        inputs: number m of inputs.
        d_max: largest age that the rows cover, samples.
        journal: takes records and events.
        period_ns: sample period, ns.
        row_sojourns: lengths of stay at d that have a row each.
    """

    def __init__(self, inputs: int, d_max: int, journal: Journal, period_ns: int, row_sojourns: int = 1) -> None:
        self._inputs, self._journal = inputs, journal
        self._forgotten = max(FLOOD * period_ns / FLOOD_NS, 1.0)  # thrown away, and no longer counted after one slot
        self._row_counts = [row_count(selection, d_max, row_sojourns) for selection in SELECTIONS]
        self._k = -1
        self._t_ns = 0
        self._sensor_frames: Sequence[bytes] = ()
        self._echo = 0
        self._echoes: dict[int, int] = {}  # of the last slots
        self._samples: dict[int, None] = {}  # instants of the samples that were sent last
        self._forgotten_ns = -1
        self._thrown = 0.0
        self._logged = 0
        self._answered: dict[int, bytes | None] = {}  # of the last slots; None where nothing came in time
        self._packet: ControlPacket | None = None
        self.data = b""
        self.late = 0
        self.first_late: int | None = None
        self.malformed = self.foreign = self.refused = 0
        self.contradicted = self.flooded = False

    def open(self, t_ns: int, k: int, sensor_frames: Sequence[bytes] = ()) -> None:
        """Begin slot k, whose answer is to come.

        Args:
            t_ns: nominal time of the slot, ns.
            k: slot.
            sensor_frames: the sensor frames whose digest the answer is to echo; none in virtual time, where it is 0.
        """
        self._t_ns, self._k, self._packet = t_ns, k, None
        self._sensor_frames = sensor_frames
        self._answered.pop(k - REMEMBERED, None)
        if sensor_frames:
            self._remember(k, sensor_frames)
        else:
            self._echo = 0
        self._logged = 0
        if self._thrown:
            self._thrown = max(self._thrown - self._forgotten, 0.0)

    def _remember(self, k: int, sensor_frames: Sequence[bytes]) -> None:
        """Keep the echo that the answer must have, and the instants of the samples that were sent."""
        self._echo = self._echoes[k] = echo(sensor_frames)
        self._echoes.pop(k - REMEMBERED, None)
        for frame in sensor_frames:
            if not frame[3] & 0x80:  # not EMPTY
                self._samples[int.from_bytes(frame[16:24], "little", signed=True)] = None
                if len(self._samples) > SAMPLES:
                    self._forgotten_ns = next(iter(self._samples))
                    del self._samples[self._forgotten_ns]

    def take(self, data: bytes, when: Arrival = "in time") -> bool:
        """Take one frame; return whether it answers the open slot.

        Args:
            data: as it came.
            when: only what came between the question and the deadline answers it.
        """
        packet = decode(data)
        if not isinstance(packet, ControlPacket):
            self.malformed += 1
            self.throw_away()
            return False
        seq = packet.seq
        if packet.echo != (self._echo if seq == self._k else self._echoes.get(seq, packet.echo)):
            to_some = seq == self._k and self._answers_some(packet.echo)
            return self._foreign(seq, data, "" if to_some else f"slot {seq}: the answer is to other frames than were sent")
        if self._sensor_frames and packet.sample_ns not in self._samples and packet.sample_ns > self._forgotten_ns:
            never_sent = f"slot {seq}: the answer uses a sample of {packet.sample_ns} ns, which was never sent"
            return self._foreign(seq, data, never_sent)
        open_now = seq == self._k and self._packet is None
        if open_now and when == "in time":
            self._packet = packet
            self._answered[seq] = self.data = data
            return True
        first = self._answered.get(seq)
        if open_now or (first is None and seq in self._answered):
            self._answered.pop(seq, None)  # the open slot is not booked as missing before it is closed
            self._late(seq, data)
            return False
        if first is None:
            early = seq != HELLO and seq > self._k
            return self._foreign(seq, data, f"slot {seq} was answered before it was asked" if early else "")
        return self._foreign(seq, data, f"slot {seq} was answered twice, differently" if data != first else "")

    def close(self) -> ControlPacket | None:
        """End the slot; return its answer, None if none came in time."""
        if self._packet is None:
            self.late += 1
            self._answered[self._k] = None
            if self.first_late is None:
                self.first_late = self._k
                self._journal.event(
                    self._t_ns, "late", "no control packet before the deadline: taken as lost", slot=self._k, severity="warning"
                )
        return self._packet

    def usable(self, packet: ControlPacket) -> bool:
        """Return whether the rows of an answer fit the loop and are finite; count it as refused if not.

        Args:
            packet: an answer in time.
        """
        expected, rows = self._row_counts[packet.selection], packet.rows
        if len(rows) == expected and len(rows[0]) == self._inputs:
            total = 0.0
            for row in rows:
                for value in row:
                    total += value
            if not (isinf(total) or isnan(total)):
                return True
            fault = "a row is not finite"
        else:
            shape = f"{len(rows)} rows of {len(rows[0]) if rows else 0}"
            fault = f"{shape}, expected {expected} of {self._inputs} for {SELECTIONS[packet.selection]!r}"
        self.refused += 1
        if self.refused == 1:
            self._journal.event(self._t_ns, REFUSED, f"control packet refused: {fault}", slot=self._k, severity="error")
        return False

    def _answers_some(self, echoed: int) -> bool:
        """Return whether an echo is that of some of the frames of this slot: the others were lost on the way."""
        sensor_frames = self._sensor_frames
        if not 1 < len(sensor_frames) <= MOST_LOST:
            return False
        kept = (compress(sensor_frames, chosen) for chosen in product((False, True), repeat=len(sensor_frames)) if chosen[-1])
        return any(echo(frames) == echoed for frames in kept)

    def _late(self, seq: int, data: bytes) -> None:
        if self._logged < LOGGED:
            self._logged += 1
            self._journal.late(self._t_ns, seq, data)

    def _foreign(self, seq: int, data: bytes, contradiction: str) -> bool:
        """Count a frame that is no answer, which may show a second controller; return False."""
        if contradiction and not self.contradicted:
            self.contradicted = True
            self._journal.event(
                self._t_ns, "second controller", f"second controller on the link: {contradiction}", slot=seq, severity="error"
            )
        self.foreign += 1
        if seq != HELLO:
            self._late(seq, data)
        self.throw_away()
        return False

    def throw_away(self, frames: int = 1) -> None:
        """Count frames that are no answer; too many in too short a time are a flood, which is logged once."""
        self._thrown += frames
        if self._thrown >= FLOOD and not self.flooded:
            self.flooded = True
            self._journal.event(
                self._t_ns, "flood", f"{FLOOD} frames that answer no sensor packet came within {FLOOD_NS // 1_000_000} ms or a "
                "slot: they are thrown away and counted, and the answer may be lost among them", slot=self._k, severity="error",
            )  # fmt: skip

    def outcome(self) -> dict[str, int | None]:
        """Return the counters that the summary needs."""
        return {
            "late": self.late,
            "first_late_slot": self.first_late,
            "malformed": self.malformed,
            "foreign": self.foreign,
            "refused": self.refused,
        }
