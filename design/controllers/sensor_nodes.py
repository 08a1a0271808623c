"""The sensor nodes of a rig: who measures what, and who may send when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Uses = Literal["history", "current-packet", "last-packets"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Turns:
    """Who is heard when: a cycle of known phase, one node after the other or as a bus with arbitration has it, or a Markov chain.

    Args:
        order: round robin: nodes in the order of their turns; empty where the turns are random.
        phase: round robin: position in the order in slot 0.
        transition: random: Pr(next node | last node), row by row; empty for a cycle.
        initial: random: probability of each node in slot 0.
        loss: probability that what is sent in a slot is lost.
        heard: a bus: in every slot of its cycle the (node, age) that it carries, age in slots of the newest sample; slot 0 is the
            first of the cycle.
    """

    order: tuple[int, ...] = ()
    phase: int = 0
    transition: tuple[tuple[float, ...], ...] = ()
    initial: tuple[float, ...] = ()
    loss: float = 0.0
    heard: tuple[tuple[tuple[int, int], ...], ...] = ()

    @property
    def cycle(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """In every slot of a cycle the (node, age) that is heard, empty for random turns."""
        return self.heard or tuple(((node, 0),) for node in self.order)

    @property
    def phases(self) -> int:
        """Number of phases: slots of a cycle, nodes of random turns."""
        return len(self.heard) or len(self.order) or len(self.transition)


def phase_at(turns: Turns | None, k: int) -> int:
    """Return the phase of a cycle in slot k.

    >>> [phase_at(Turns(order=(0, 1, 2), phase=1), k) for k in range(4)]
    [1, 2, 0, 1]
    """
    return 0 if turns is None or not turns.cycle else (k + turns.phase) % turns.phases


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNodes:
    """The sensor nodes of a rig, one or more.

    Args:
        names: of the nodes, by number.
        outputs: per node the indices of the plant's outputs that it measures.
        buffers: per node the samples of a packet.
        delays: per node the constant delay of its packets, in slots; None where the delay changes or packets get lost on the way.
        turns: who may send when; None where every node sends in every slot.
        silent: nodes that may let their turn pass, by their trigger or their clock.
        mixed: some nodes share a medium and others do not, or there are several media.
        unforeseen: why nobody knows beforehand who is heard when, empty where it is known.
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
