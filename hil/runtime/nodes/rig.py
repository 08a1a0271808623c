"""The rig node: the emulated hardware and the emulated network on both sides of it.

Nothing here does I/O or reads a clock: :meth:`Rig.sense` returns the frames that leave, :meth:`Rig.hear` takes those that
come, records go to a sink, and time is the nominal time that the kernel hands over. The order of a slot stands in
:mod:`hil.runtime.slot`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite, nan
from typing import Any

from design.controllers import row_count
from hil.compose.loop import Loop
from hil.log.records import Channel
from hil.log.write.sinks import Sink
from hil.runtime.nodes.controller_node import HELLO
from hil.runtime.nodes.safety import Safety
from hil.runtime.streams import rng_for
from transport.medium.independent import Draw, impair
from transport.packets import EMPTY, MORE, SELECTIONS, ControlPacket, SensorPacket, decode, encode_sensor

OK, HOLD, NONE_YET, SAFE = range(4)  # the codes of /actuator/applied.status


def row_index(selection: str, d: int, g: int, measured_d: Sequence[int], d_max: int) -> int:
    """Return which row the actuator applies (see :mod:`design.controllers`).

    Args:
        selection: the rule that the packet names.
        d, g: age of the packet now, and the slot in which it was generated.
        measured_d: what the actuator measured in slots 0, 1, ...; -1 where there was no packet.
        d_max: largest age that the rows cover.

    >>> [row_index(s, 1, 2, [0, 1, 0, 1], 1) for s in ("constant", "generated", "applied", "previous", "both")]
    [0, 0, 1, 1, 1]
    """
    if selection == "constant":
        return 0
    if selection == "applied":
        return d
    at = measured_d[max(g - 1, 0)] if selection == "previous" else measured_d[g]
    seen = at if 0 <= at <= d_max else d_max  # nothing usable was there: the longest delay
    return seen * (d_max + 1) + d if selection == "both" else seen


class Rig:
    """Plant, sensor, actuator, network laws and safety of one loop.

    Args:
        loop: the composed experiment.
        seed: seed of the run.
        sink: where records go.
        channels: the table of what is logged.
        stop: ends the run (after a trip of the safety, once ``after_trip`` has passed).
    """

    def __init__(
        self,
        loop: Loop,
        seed: int,
        sink: Sink,
        channels: dict[str, Channel],
        stop: Callable[[], None],
    ) -> None:
        e = loop.experiment
        names = [s.name for s in e.plant.states]
        deadline_s = e.timing.deadline * float(e.period)
        self._period_ns = e.period_ns
        self._d_max = loop.model.d_max
        self._inputs = len(e.plant.inputs)
        self._samples = loop.samples
        self._sample: tuple[float, ...] = ()
        self._y: Sequence[float] = ()
        self._draws: Sequence[Draw] = ()
        self._zero = (0.0,) * self._inputs
        self._plant = e.plant.start(rng_for(seed, "plant"))
        self._sc = impair(loop.sc_law, rng_for(seed, "link.sc"), float(e.period), deadline_s)
        self._ca = impair(loop.ca_law, rng_for(seed, "link.ca"), float(e.period), deadline_s)
        self._reference, self._disturbance = loop.reference(), loop.disturbance()
        self._safety = Safety(
            e.limits.input, [(names.index(n), n, b) for n, b in e.limits.state.items()], e.limits.watchdog_ticks
        )
        self._after_trip = round(e.limits.after_trip / e.period)
        self._end: int | None = None
        self._stop, self._sink = stop, sink
        self._log = {topic: (sink.channel(topic), c.schema.pack) for topic, c in channels.items()}
        self._log_state, self._pack_state = self._log["/plant/state"]
        self._log_y, self._pack_y = self._log["/plant/measurement"]
        self._log_r, self._pack_r = self._log["/reference"]
        self._log_u, self._pack_u = self._log["/actuator/applied"]
        self._log_rows, self._pack_rows = self._log["/controller/rows"]
        self._row_slots = loop.rows * self._inputs
        self._row_counts = [row_count(selection, self._d_max) for selection in SELECTIONS]

        self.k = -1
        self.late = 0
        self.first_late: int | None = None
        self.malformed = 0
        self.refused = 0
        self._answer: ControlPacket | None = None
        self._answer_bytes, self._answered = b"", -1
        self.contradicted = False
        self._held: ControlPacket | None = None
        self._held_tick = -1
        self._measured_d: list[int] = []
        self._u: tuple[float, ...] = self._zero
        self._w: tuple[float, ...] = self._zero

    @property
    def tripped(self) -> str | None:
        """Why safety stopped the run, None if it did not."""
        return self._safety.tripped

    def sense(self, t_ns: int) -> list[bytes]:
        """Advance the plant to t_k, measure, and return the frames of what the S-C law lets arrive in this slot."""
        k = self.k = t_ns // self._period_ns
        plant = self._plant
        if k:
            plant.advance(self._period_ns, self._u, self._w)
        y = self._y = plant.measure()
        # What a packet carries: this measurement, and those of the slots before as far as the controller takes them.
        self._sample = (y + self._sample)[: len(y) * self._samples] if k else y * self._samples
        self._answer = None
        self._sc.offer(k, self._sample)
        self._draws, arrivals = self._sc.collect(k)
        return self._frames(k, arrivals)

    def record(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Record what was sensed and sent, and trip on a state beyond its limit.

        Args:
            t_ns: nominal time of the slot, ns.
            frames: what :meth:`sense` returned.
        """
        k, state = self.k, self._plant.state
        if self._log_state:
            self._log_state(t_ns, self._pack_state(*state, k))
        if self._log_y:
            self._log_y(t_ns, self._pack_y(*self._y, k))
        if self._log_r:
            self._log_r(t_ns, self._pack_r(*self._reference(k), k))
        self._record_draws("/network/sc", t_ns, self._draws)
        log, pack = self._log["/link/sensor"]
        if log:
            for frame in frames:
                log(t_ns, pack(k, 0, frame))
        reason = self._safety.check_state(state)
        if reason:
            self._trip(t_ns, reason)

    def _frames(self, k: int, arrivals: Sequence[tuple[int, object]]) -> list[bytes]:
        if not arrivals:
            return [encode_sensor(SensorPacket(k, EMPTY, 0, ()))]
        last = len(arrivals) - 1
        return [
            encode_sensor(SensorPacket(k, MORE if i < last else 0, g * self._period_ns, y))  # type: ignore[arg-type]
            for i, (g, y) in enumerate(arrivals)
        ]

    def hear(self, data: bytes) -> bool:
        """Take one frame from the link; return True when it answers the current slot."""
        packet = decode(data)
        if not isinstance(packet, ControlPacket):
            self.malformed += 1
            return False
        if packet.seq != self.k:
            if packet.seq == self._answered and data != self._answer_bytes and not self.contradicted:
                self.contradicted = True
                self._sink.event(
                    self.k * self._period_ns, "second controller", "somebody else answered too, and otherwise: the link has two "
                    "controllers", tick=packet.seq, severity="error",
                )  # fmt: skip
            if packet.seq != HELLO:
                log, pack = self._log["/link/control"]
                if log:
                    log(self.k * self._period_ns, pack(packet.seq, 1, data))
            return False
        if self._answer is None:
            self._answer, self._answer_bytes, self._answered = packet, data, packet.seq
        return True

    def actuate(self, t_ns: int) -> None:
        """Let the C-A law pass what it passes, choose the row, and hold it until the next slot."""
        k, packet = self.k, self._answer
        if packet is None:
            self.late += 1
            if self.first_late is None:
                self.first_late = k
                self._sink.event(
                    t_ns, "late", "no control packet before the deadline: taken as lost", tick=k, severity="warning"
                )
        elif self._acceptable(packet, t_ns):
            self._ca.offer(k, packet)
        draws, arrivals = self._ca.collect(k)
        for g, arrived in arrivals:
            if g >= self._held_tick:
                self._held_tick, self._held = g, arrived  # type: ignore[assignment]
        d, row, status = self._apply(t_ns)
        self._w = self._disturbance(k)
        if self._log_u:
            self._log_u(t_ns, self._pack_u(*self._u, *self._w, k, self._held_tick, d, row, status))
        self._record_draws("/network/ca", t_ns, draws)
        if packet is not None:
            self._record_answer(t_ns, packet)
        if self._end is not None and k >= self._end:
            self._stop()

    def _acceptable(self, packet: ControlPacket, t_ns: int) -> bool:
        expected, rows = self._row_counts[packet.selection], packet.rows
        fault = None
        if len(rows) != expected or len(rows[0]) != self._inputs:
            shape = f"{len(packet.rows)} rows of {len(packet.rows[0]) if packet.rows else 0}"
            fault = f"{shape}, expected {expected} of {self._inputs} for {SELECTIONS[packet.selection]!r}"
        elif not isfinite(sum(map(sum, rows))):
            fault = "a row is not finite"
        if fault is None:
            return True
        self.refused += 1
        if self.refused == 1:
            self._sink.event(
                t_ns, "refused", f"control packet refused: {fault}", tick=self.k, severity="error"
            )
        return False

    def _apply(self, t_ns: int) -> tuple[int, int, int]:
        """Set the input for this slot; return measured d, row, status."""
        k, held, g = self.k, self._held, self._held_tick
        d = k - g if held is not None else -1
        self._measured_d.append(d)
        if self._safety.tripped is not None:
            return d, -1, SAFE
        if held is None or d > self._d_max:
            reason = self._safety.starved() if k > self._d_max else None
            if reason:
                self._trip(t_ns, reason)
                return d, -1, SAFE
            return d, -1, HOLD if held is not None else NONE_YET
        row = row_index(SELECTIONS[held.selection], d, g, self._measured_d, self._d_max)
        u = held.rows[row]
        reason = self._safety.check_command(u)
        if reason:
            self._trip(t_ns, reason)
            return d, -1, SAFE
        self._safety.fed()
        self._u = u
        return d, row, OK

    def _trip(self, t_ns: int, reason: str) -> None:
        self._u = self._zero
        self._end = self.k + self._after_trip
        self._sink.event(
            t_ns, "safety", f"safe state (zero input, latched): {reason}", tick=self.k, severity="error"
        )

    def _record_draws(self, topic: str, t_ns: int, draws: Sequence[Draw]) -> None:
        log, pack = self._log[topic]
        if log:
            for tick, packet_tick, mode, age, latency_s, reason in draws:
                log(t_ns, pack(latency_s, tick, packet_tick, mode, age, reason))

    def _record_answer(self, t_ns: int, packet: ControlPacket) -> None:
        log, pack = self._log["/link/control"]
        if log:
            log(t_ns, pack(self.k, 0, self._answer_bytes))
        if self._log_rows:
            values = [v for row in packet.rows for v in row][: self._row_slots]
            values += [nan] * (self._row_slots - len(values))
            self._log_rows(
                t_ns,
                self._pack_rows(*values, packet.sample_ns, packet.control_ns, self.k, packet.tau, packet.selection),
            )

    def outcome(self) -> dict[str, Any]:
        """Return the counters that the summary needs."""
        return {
            "ticks": self.k + 1,
            "late": self.late,
            "first_late_tick": self.first_late,
            "malformed": self.malformed,
            "refused": self.refused,
            "safety": self._safety.tripped,
        }
