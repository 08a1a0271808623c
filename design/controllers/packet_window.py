"""The outcomes of the last slots, as one number: who was heard in each, or that nothing came.

Over a cycle the sender of a slot is known, and an outcome is whether its packet came: the phase is turn + L * bits, bit e set
where the packet of e slots ago is missing. Over random turns an outcome is the node that was heard, or one number more where
nothing came: the phase is the sum of outcome(e) * base^e. Slots before slot 0 count as heard in a cycle, and as slot 0 over
random turns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from design.controllers.sensor_nodes import Turns
from design.errors import FieldError

MOST_PHASES = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketWindow:
    """The outcomes of the last ``length`` slots.

    Args:
        turns: one packet in a slot: a cycle that loses packets, or random turns.
        length: slots, at least 1.
    """

    turns: Turns
    length: int

    def __post_init__(self) -> None:
        if self.turns.heard or (self.turns.order and not self.turns.loss):
            raise FieldError("uses", "the last packets differ where turns are random or packets get lost: uses = 'history'")
        if self.length < 1:
            raise FieldError("window", f"{self.length} slots, expected at least 1")
        if self.phases > MOST_PHASES:
            raise FieldError("window", f"{self.length} slots have {self.phases} outcomes, the limit is {MOST_PHASES}")

    @property
    def base(self) -> int:
        """Outcomes of one slot."""
        return 2 if self.turns.order else len(self.turns.transition) + bool(self.turns.loss)

    @property
    def phases(self) -> int:
        """Number of phases."""
        return max(len(self.turns.order), 1) * int(self.base**self.length)

    def phase(self, sent: int, came: Callable[[int], int | None]) -> int:
        """Return the phase in the slot in which the packet of slot ``sent`` would have come.

        Args:
            sent: newest slot whose packet can have come, at least 0.
            came: the node whose packet of a slot has come, None where none has.
        """
        turns, count = self.turns, len(self.turns.order)
        total = 0
        for e in range(self.length):
            slot = sent - e
            if count:
                outcome = int(slot >= 0 and came(slot) is None)
            else:
                node = came(max(slot, 0))
                outcome = self.base - 1 if node is None else node
            total += outcome * self.base**e
        return (sent + turns.phase) % count + count * total if count else total

    def outcomes(self, phase: int) -> tuple[int | None, ...]:
        """Return the node that was heard e slots ago for e = 0, ..., length - 1, None where nothing came."""
        order = self.turns.order
        digits, turn = phase // max(len(order), 1), phase % max(len(order), 1)
        found: list[int | None] = []
        for e in range(self.length):
            digit = digits // self.base**e % self.base
            if order:
                found.append(None if digit else order[(turn - e) % len(order)])
            else:
                found.append(digit if digit < len(self.turns.transition) else None)
        return tuple(found)


def window_of(turns: Turns, phases: int) -> PacketWindow:
    """Return the window that has so many phases.

    Raises:
        ValueError: there is none.
    """
    length = 1
    while True:
        window = PacketWindow(turns=turns, length=length)
        if window.phases == phases:
            return window
        if window.phases > phases or window.base == 1:
            one, two = (PacketWindow(turns=turns, length=n).phases for n in (1, 2))
            raise FieldError("gains", f"{phases} phases, but the last packets of this schedule have {one} (one slot) or {two}")
        length += 1
