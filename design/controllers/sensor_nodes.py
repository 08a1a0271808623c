"""The sensor nodes of a rig: who measures what, and who may send when.

The outcomes of the last slots, as one number: whose packet came in each, or that nothing came.

Over a cycle the sender of a slot is known, and an outcome is whether its packet came: the phase is turn + L * bits, bit e set
where the packet of e slots ago is missing. Over random turns an outcome is the node whose packet came, or one number more where
nothing came: the phase is the sum of outcome(e) * base^e. Slots before slot 0 count as received in a cycle, and as slot 0 over
random turns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from msgspec import Struct

from design.errors import FieldError

Uses = Literal["history", "current-packet", "last-packets"]


class Turns(Struct, frozen=True, kw_only=True):
    """Whose packet comes when: a cycle of known phase (one node after the other, or the order of a bus), or a Markov chain.

    Args:
        order: round robin: nodes in the order of their turns; empty where the turns are random.
        phase: round robin: position in the order in slot 0.
        transition: random: Pr(next node | last node), row by row; empty for a cycle.
        initial: random: probability of each node in slot 0.
        loss: probability that what is sent in a slot is lost.
        received: a bus: in every slot of its cycle the (node, age) that it carries, age in slots of the newest sample; slot 0
            is the first of the cycle.
    """

    order: tuple[int, ...] = ()
    phase: int = 0
    transition: tuple[tuple[float, ...], ...] = ()
    initial: tuple[float, ...] = ()
    loss: float = 0.0
    received: tuple[tuple[tuple[int, int], ...], ...] = ()

    @property
    def cycle(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """In every slot of a cycle the (node, age) that is received, empty for random turns."""
        return self.received or tuple(((node, 0),) for node in self.order)

    @property
    def phases(self) -> int:
        """Number of phases: slots of a cycle, nodes of random turns."""
        return len(self.received) or len(self.order) or len(self.transition)


def phase_at(turns: Turns | None, k: int) -> int:
    """Return the phase of a cycle in slot k.

    >>> [phase_at(Turns(order=(0, 1, 2), phase=1), k) for k in range(4)]
    [1, 2, 0, 1]
    """
    return 0 if turns is None or not turns.cycle else (k + turns.phase) % turns.phases


class SensorNodes(Struct, frozen=True, kw_only=True):
    """The sensor nodes of a rig, one or more.

    Args:
        names: of the nodes, by number.
        outputs: per node the indices of the plant's outputs that it measures.
        buffers: per node the samples of a packet.
        delays: per node the constant delay of its packets, in slots; None where the delay changes or packets get lost on the way.
        turns: who may send when; None where every node sends in every slot.
        silent: nodes that may let their turn pass, by their trigger or their clock.
        mixed: some nodes share a medium and others do not, or there are several media.
        unforeseen: why it is not known beforehand which packet comes when, empty where it is known.
    """

    names: tuple[str, ...]
    outputs: tuple[tuple[int, ...], ...]
    buffers: tuple[int, ...]
    delays: tuple[int | None, ...]
    turns: Turns | None = None
    silent: tuple[str, ...] = ()
    mixed: bool = False
    unforeseen: str = ""


def one_node(outputs: int) -> SensorNodes:
    """Return the only node of a rig, which measures so many outputs and sends in every slot.

    >>> one_node(2).outputs
    ((0, 1),)
    """
    return SensorNodes(names=("sensor",), outputs=(tuple(range(outputs)),), buffers=(1,), delays=(None,))


MOST_PHASES = 1024


class PacketWindow(Struct, frozen=True, kw_only=True):
    """The outcomes of the last ``length`` slots.

    Args:
        turns: one packet in a slot: a cycle that loses packets, or random turns.
        length: slots, at least 1.
    """

    turns: Turns
    length: int

    def __post_init__(self) -> None:
        if self.turns.received or (self.turns.order and not self.turns.loss):
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
        """Return the node whose packet came e slots ago for e = 0, ..., length - 1, None where nothing came."""
        order = self.turns.order
        digits, turn = divmod(phase, len(order) or 1)
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
