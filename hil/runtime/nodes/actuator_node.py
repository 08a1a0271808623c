"""The actuator node: holds the newest packet, chooses the row, keeps the watchdog and the safe state."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from hil.runtime.nodes.safety import Injected, PortDamper, Safety
from transport.packets import SELECTIONS, ControlPacket

OK: Final = 0
HOLD: Final = 1
NONE_YET: Final = 2
SAFE: Final = 3
"""The codes of /actuator/applied.status."""

_new: Final = tuple.__new__  # without the Python constructor: in five files 6 % of an interpreted virtual slot


def row_index(
    selection: str, d: int, g: int, measured_d: Mapping[int, int] | Sequence[int], d_max: int, row_sojourns: int = 1
) -> int:
    """Return which row the actuator applies (see :mod:`design.controllers`).

    Args:
        selection: the rule that the packet names.
        d, g: age of the packet now, and the slot in which it was generated.
        measured_d: what the actuator measured, by slot; -1 where there was no packet.
        d_max: largest age that the rows cover.
        row_sojourns: lengths of stay at d that have a row each.

    >>> [row_index(s, 1, 2, [0, 1, 0, 1], 1) for s in ("constant", "generated", "applied", "previous", "both")]
    [0, 0, 1, 1, 1]
    >>> [row_index("applied", d, k - d, [0, 1, 1, 1, 0], 1, 2) for k, d in enumerate([0, 1, 1, 1, 0])]
    [0, 2, 3, 3, 0]
    """
    if selection == "constant":
        return 0
    if selection == "applied":
        return d if row_sojourns == 1 else d * row_sojourns + _lasted(measured_d, g + d, row_sojourns) - 1
    at = measured_d[max(g - 1, 0)] if selection == "previous" else measured_d[g]
    seen = at if 0 <= at <= d_max else d_max  # nothing usable was there: the longest delay
    return seen * (d_max + 1) + d if selection == "both" else seen


def _lasted(measured_d: Mapping[int, int] | Sequence[int], k: int, most: int) -> int:
    """Return for how many slots, slot k included, the delay of slot k has been measured; `most` if longer."""
    slots = 1
    while slots < most and slots <= k and measured_d[k - slots] == measured_d[k]:
        slots += 1
    return slots


class Applied(NamedTuple):
    """What the actuator did in a slot.

    Attributes:
        u: input that is held until the next slot, shape (m,).
        packet_slot: slot in which the packet was generated, -1 if none has come.
        d: measured age of the packet, samples; -1 if none has come.
        row: index of the row, -1 if none was applied.
        status: OK, HOLD, NONE_YET or SAFE.
        tripped: why safety tripped in this slot, None if it did not.
        injected: what the passivity controller saw and did, None without one.
    """

    u: tuple[float, ...]
    packet_slot: int
    d: int
    row: int
    status: int
    tripped: str | None
    injected: Injected | None = None


class ActuatorNode:
    """Applies one row of the newest packet in every slot, or zero once safety has tripped.

    Args:
        inputs: number m of inputs.
        d_max: largest age of a packet that its rows cover, samples.
        safety: limits and watchdog, latched.
        damper: passivity controller at the port of a device with one input.
        row_sojourns: lengths of stay at d that have a row each.
    """

    def __init__(self, inputs: int, d_max: int, safety: Safety, damper: PortDamper | None = None, row_sojourns: int = 1) -> None:
        self._d_max, self._safety, self._damper = d_max, safety, damper
        self._row_sojourns, self._remembered = row_sojourns, max(d_max + 2, row_sojourns)
        self._command: tuple[float, ...] = (0.0,) * inputs  # without what the damper adds
        self._zero = (0.0,) * inputs
        self._held: ControlPacket | None = None
        self._held_slot = -1
        self._measured_d: dict[int, int] = {}  # of the slots that a packet in use may refer to, no more
        self.u: tuple[float, ...] = self._zero

    @property
    def tripped(self) -> str | None:
        """Why safety stopped the run, None if it did not."""
        return self._safety.tripped

    def watch(self, state: Sequence[float]) -> str | None:
        """Trip on a plant state beyond its limit; return the reason when this call trips.

        Args:
            state: the plant's state.
        """
        reason = self._safety.check_state(state)
        return None if reason is None else self._latch(reason)

    def update_observer(self, position: float, force: float) -> str | None:
        """Let the passivity controller see what the motor did; return the reason when it trips.

        Args:
            position: where the device is now, as measured.
            force: what the motor put out in the slot before.
        """
        reason = None if self._damper is None else self._damper.observe(position, force)
        return None if reason is None else self._latch(self._safety.trip(reason))

    def _latch(self, reason: str | None) -> str | None:
        if reason is not None:
            self.u = self._command = self._zero
        return reason

    def apply(self, k: int, arrivals: Iterable[tuple[int, Any]], now_ns: int = 0) -> Applied:
        """Take what arrived in slot k, measure d_k, choose the row, and set the input for this slot.

        Args:
            k: slot.
            arrivals: (slot of generation, control packet) each, in order of arrival.
            now_ns: when the slot began, ns; the watchdog looks at it.
        """
        for g, arrived in arrivals:
            if g >= self._held_slot:
                self._held_slot, self._held = g, arrived
        held, g = self._held, self._held_slot
        d = self._measured_d[k] = -1 if held is None else k - g
        self._measured_d.pop(k - self._remembered, None)
        row, status, reason = -1, SAFE, None
        if self._safety.tripped is None:
            if held is None or d > self._d_max:
                status = HOLD if held is not None else NONE_YET
                reason = self._safety.starved(now_ns) if k > self._d_max else None
            else:
                status = OK
                row = row_index(SELECTIONS[held.selection], d, g, self._measured_d, self._d_max, self._row_sojourns)
                u = held.rows[row]
                reason = self._safety.check_command(u)
                if reason is None:
                    self.u = self._command = u
        if reason is not None:
            self._latch(reason)
            row, status = -1, SAFE
        if self._damper is None:
            return _new(Applied, (self.u, g, d, row, status, reason, None))
        if status == SAFE:
            injected = Injected(self._damper.energy_j, 0.0, 0.0)
        else:
            put_out, injected = self._damper.damp(self._command[0])
            self.u = (put_out,)
        return Applied(self.u, g, d, row, status, reason, injected)
