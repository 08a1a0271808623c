"""Sensor nodes of a rig as the theory of Chapter 5 takes them: what is known in each phase, and the chain of the phases.

Over a cycle the phase is the turn, and a turn whose packet may get lost has a twin in which nothing came. Over random turns the
phase is the node whose packet came.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.controllers.sensor_nodes import SensorNodes, Turns, Uses
from design.errors import FieldError
from design.historical_data.lifted_loop import cycle

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class Information:
    """Who measures what, who sends when, and how much of the past a packet carries.

    Args:
        nodes: per state the number of the node that measures it, counted from 0.
        order: which node sends in phase 0, 1, ...; (0, 1, ..., n - 1) is round robin (5.2).
        buffer: m, samples of each state in a packet, the newest first.
        memory: tau, the oldest sample x(k - tau) that the controller uses.
        delay: sensor-to-controller delay, samples.

    Raises:
        ValueError: a number that does not fit; the message begins with its name.
    """

    nodes: tuple[int, ...]
    order: tuple[int, ...]
    buffer: int
    memory: int
    delay: int = 0

    def __post_init__(self) -> None:
        if not self.nodes or min(self.nodes) < 0:
            raise FieldError("nodes", f"{list(self.nodes)}, expected a node from 0 for every state")
        unknown = sorted(set(self.order) - set(self.nodes))
        if not self.order or unknown:
            raise FieldError("order", f"{list(self.order)}, expected nodes that measure something: {sorted(set(self.nodes))}")
        if self.memory < 0:
            raise FieldError("memory", f"{self.memory}, expected 0 or more")
        if not 1 <= self.buffer <= self.memory + 1:
            raise FieldError("buffer", f"{self.buffer} samples, expected 1 to memory + 1 = {self.memory + 1}")
        if not 0 <= self.delay <= self.memory:
            raise FieldError("delay", f"{self.delay} samples, expected 0 to the memory, {self.memory}")

    @property
    def phases(self) -> int:
        """L, the length of the schedule."""
        return len(self.order)

    def newest(self, phase: int, node: int) -> list[int]:
        """Return the ages of the packets of a node that have arrived in a phase, newest first, as far as the memory reaches."""
        ages = range(self.delay, self.memory + 1)
        return [e for e in ages if self.order[(phase - e) % self.phases] == node]

    def mask(self) -> Mask:
        """Return which gains may differ from zero, (phases, memory + 1, states): [i, j, l] stands for x_l(k - j).

        >>> print(Information(nodes=(0, 1, 2, 3), order=(0, 1, 2, 3), buffer=3, memory=5).mask()[2].astype(int))
        [[0 0 1 0]
         [0 1 1 0]
         [1 1 1 0]
         [1 1 0 1]
         [1 0 1 1]
         [0 1 1 1]]
        """
        known = np.zeros((self.phases, self.memory + 1, len(self.nodes)), dtype=bool)
        for i in range(self.phases):
            for state, node in enumerate(self.nodes):
                for e in self.newest(i, node):
                    known[i, e : e + self.buffer, state] = True
        return known


def round_robin(states: int, *, buffer: int, memory: int | None = None, delay: int = 0) -> Information:
    """Return the chapter's arrangement: sensor l measures x_l, one after the other (5.2).

    Args:
        states: n.
        buffer: m.
        memory: tau; default n + m - 2 + delay, the oldest sample of the first full cycle.
        delay: sensor-to-controller delay, samples.
    """
    every = tuple(range(states))
    reach = states + buffer - 2 + delay if memory is None else memory
    return Information(nodes=every, order=every, buffer=buffer, memory=reach, delay=delay)


Array = npt.NDArray[np.float64]


def mask_of(nodes: SensorNodes, memory: int, uses: Uses) -> Mask:
    r"""Return which gains may differ from zero, (phases, memory + 1, outputs).

    They are the zero-element constraints (5.8), in general.

    A schedule of L phases names the node that sends in each. In a slot of phase i the packet sent e slots ago (phase i - e) has
    arrived if e >= delay, and it holds the m newest samples that its node had then. So x_l(k - j) is known iff

    .. math:: \exists\, e \ge \text{delay}:\quad \text{order}[(i - e) \bmod L] = \text{node}(l), \qquad 0 \le j - e \le m - 1 .

    DEVIATION: Remark 5.2 sets K(., 0) = 0 for a delay of one sample. The whole mask shifts instead: what was sent one slot later
    is known one slot later.

    Args:
        nodes: the sensor nodes.
        memory: tau, the oldest sample x(k - tau) that the controller uses.
        uses: all that has come, or the packet of this slot.

    Raises:
        ValueError: a delay that changes, or a buffer that is longer than the history; the message begins with the place.

    >>> one = SensorNodes(names=("a", "b"), outputs=((0,), (1,)), buffers=(1, 2), delays=(0, 0), turns=Turns(order=(0, 1)))
    >>> mask_of(one, 1, "history").astype(int).tolist()
    [[[1, 0], [0, 1]], [[0, 1], [1, 1]]]
    """
    outputs = sum(map(len, nodes.outputs))
    delays = [delay for delay in nodes.delays if delay is not None]
    if len(delays) < len(nodes.delays):
        raise FieldError("nodes", "the theory knows which samples have arrived only where every node has a constant delay")
    for name, buffer, delay in zip(nodes.names, nodes.buffers, delays):
        if buffer + delay > memory + 1:
            raise FieldError(
                f"network.nodes.{name}.buffer",
                f"{buffer} samples that are {delay} slots late, but the gains reach back {memory} slots only",
            )
    turns = nodes.turns
    count = 1 if turns is None else turns.phases
    cycle = () if turns is None else turns.cycle
    known = np.zeros((count, memory + 1, outputs), dtype=bool)
    for n, (own, buffer, delay) in enumerate(zip(nodes.outputs, nodes.buffers, delays)):
        if turns is None:
            known[0, delay:, list(own)] = True
            continue
        if uses == "history" and cycle:
            for i in range(count):
                for e in range(delay, memory + 1):
                    for age in [age for node, age in cycle[(i - e) % count] if node == n]:
                        known[i, e + age : e + age + buffer, list(own)] = True
            continue
        for i in range(count):  # a phase of the current packet is the turn in which it was sent
            if (turns.order[i] if turns.order else i) == n:
                known[i, delay : delay + buffer, list(own)] = True
    return known


def lossy(turns: Turns | None) -> bool:
    """Return whether a phase has a twin in which nothing came."""
    return turns is not None and turns.loss > 0.0


def phase_chain(nodes: SensorNodes) -> Array | None:
    """Return the transition matrix of the phases, those in which nothing came last; None for a cycle without loss."""
    turns = nodes.turns
    if turns is None or (turns.cycle and not turns.loss):
        return None
    plain = cycle(turns.phases) if turns.cycle else np.array(turns.transition)
    return np.kron([[1.0 - turns.loss, turns.loss]] * 2, plain) if turns.loss else plain


def phases_at_start(nodes: SensorNodes, uses: Uses) -> Array:
    """Return the distribution of the phases in slot 0; those of the current packet count from the turn in which it was sent."""
    turns = nodes.turns
    if turns is None:
        return np.ones(1)
    if turns.cycle:
        late = (nodes.delays[0] or 0) if uses == "current-packet" else 0
        start = np.eye(turns.phases)[(turns.phase - late) % turns.phases]
    else:
        start = np.array(turns.initial)
    return np.kron([1.0 - turns.loss, turns.loss], start) if turns.loss else start


def with_lost_turns(array: npt.NDArray[np.generic], nodes: SensorNodes) -> npt.NDArray[np.generic]:
    """Return gains or a mask with zeros for the phases in which nothing came, where packets may get lost."""
    return np.concatenate([array, np.zeros_like(array)]) if lossy(nodes.turns) else array


def _stationary(turns: Turns | None) -> bool:
    """Whether slot 0 is drawn as every other slot."""
    if turns is None or not turns.transition:
        return True
    return bool(np.allclose(np.array(turns.initial) @ np.array(turns.transition), turns.initial, atol=1e-12))


def undecided_because(nodes: SensorNodes) -> str:
    """Return what about the nodes the theory does not know, empty if nothing; a trigger is the caller's to look at."""
    if nodes.mixed:
        return "the theory knows nodes that all share one medium, or that all send when they will"
    if nodes.unforeseen:
        return nodes.unforeseen
    if None in nodes.delays:
        return "the theory knows constant delays of sensor packets only"
    if any(nodes.delays) and not _stationary(nodes.turns):
        return "the theory knows late packets of random turns where slot 0 is drawn from the chain's stationary distribution"
    return ""
