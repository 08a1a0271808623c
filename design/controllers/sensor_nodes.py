"""Several sensor nodes, as a controller sees them: who measures what, who may send when, and what has arrived."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import LoopModel, Rows, RunningController, Selection

Uses = Literal["history", "current-packet", "last-packets"]


class Sample(NamedTuple):
    """What one node measured in one slot.

    Attributes:
        node: number of the node, from 0.
        slot: slot of the measurement.
        values: one entry per output of the node, in the outputs' units.
    """

    node: int
    slot: int
    values: tuple[float, ...]


class Known(NamedTuple):
    """What a controller knows in a slot.

    Attributes:
        samples: what has arrived, newest first: of each node every sample that is at most `memory` slots old, and its newest one.
        reference: one entry per output.
    """

    samples: tuple[Sample, ...]
    reference: tuple[float, ...]


@runtime_checkable
class FromSamples(Protocol):
    """A running controller that is told which node measured what and when; any number of nodes serves it."""

    selection: Selection
    memory: int
    """Age in slots of the oldest sample that it uses."""

    def rows(self, k: int, known: Known) -> Rows:
        """Return one row of m inputs per row index; called once a slot, in order, once a sample is known."""
        ...


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


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNodes:
    """The sensor nodes of a rig.

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


@runtime_checkable
class HistoryGains(Protocol):
    """Gains over what scheduled nodes have sent: u(k) = sum_j K[i, j] y(k - j); certified where the state is measured."""

    uses: Uses

    def start(self, model: LoopModel) -> FromSamples | RunningController: ...

    def history(self) -> NDArray[np.float64]:
        """Return K[phase, j, m, p]; a phase is a turn of the cycle, or the node whose packet has just come."""
        ...
