"""Sensor nodes of a rig as the theory of Chapter 5 takes them: what is known in each phase, and the chain of the phases.

Over a cycle the phase is the turn, and a turn whose packet may get lost has a twin in which nothing came. Over random turns the
phase is the node whose packet came.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt

from design.controllers.sensor_nodes import SensorNodes, Turns, Uses
from design.errors import FieldError
from design.historical_data import Array, cycle

Mask = npt.NDArray[np.bool_]


def round_robin(states: int, *, buffer: int, delay: int = 0) -> SensorNodes:
    """Return the chapter's arrangement: sensor l measures x_l, one after the other (5.2).

    Args:
        states: n.
        buffer: m, samples of the state in a packet, the newest first.
        delay: sensor-to-controller delay, samples.
    """
    every = tuple(range(states))
    return SensorNodes(
        names=tuple(f"x{l + 1}" for l in every), outputs=tuple((l,) for l in every), buffers=(buffer,) * states,
        delays=(delay,) * states, turns=Turns(order=every),
    )  # fmt: skip


def mask_of(nodes: SensorNodes, memory: int | None = None, uses: Uses = "history") -> Mask:
    r"""Return which gains may differ from zero, (phases, memory + 1, outputs).

    They are the zero-element constraints (5.8), in general.

    A schedule of L phases names the node that sends in each. In a slot of phase i the packet sent e slots ago (phase i - e) has
    arrived if e >= delay, and it holds the m newest samples that its node had then. So x_l(k - j) is known iff

    .. math:: \exists\, e \ge \text{delay}:\quad \text{order}[(i - e) \bmod L] = \text{node}(l), \qquad 0 \le j - e \le m - 1 .

    DEVIATION: Remark 5.2 sets K(., 0) = 0 for a delay of one sample. The whole mask shifts instead: what was sent one slot later
    is known one slot later.

    Args:
        nodes: the sensor nodes.
        memory: tau, the oldest sample x(k - tau) that the controller uses; default the oldest of the first full cycle, or of a
            packet.
        uses: all that has come, or the packet of this slot.

    Raises:
        ValueError: a delay that changes, or a buffer that is longer than the history; the message begins with the place.

    >>> one = SensorNodes(names=("a", "b"), outputs=((0,), (1,)), buffers=(1, 2), delays=(0, 0), turns=Turns(order=(0, 1)))
    >>> mask_of(one, 1).astype(int).tolist()
    [[[1, 0], [0, 1]], [[0, 1], [1, 1]]]
    >>> print(mask_of(round_robin(4, buffer=3))[2].astype(int))
    [[0 0 1 0]
     [0 1 1 0]
     [1 1 1 0]
     [1 1 0 1]
     [1 0 1 1]
     [0 1 1 1]]
    """
    outputs = sum(map(len, nodes.outputs))
    delays = [delay for delay in nodes.delays if delay is not None]
    if len(delays) < len(nodes.delays):
        raise FieldError("nodes", "the theory knows which samples have arrived only where every node has a constant delay")
    turns = nodes.turns
    cycle = turns.cycle if turns is not None and uses == "history" else ()
    if memory is None:
        waited = max((age for slot in cycle for _, age in slot), default=0)
        memory = max(len(cycle) - 1, 0) + waited + max(nodes.buffers) - 1 + max(delays)
    for name, buffer, delay in zip(nodes.names, nodes.buffers, delays):
        if buffer + delay > memory + 1:
            raise FieldError(
                f"network.nodes.{name}.buffer",
                f"{buffer} samples that are {delay} slots late, but the gains reach back {memory} slots only",
            )
    count = 1 if turns is None else turns.phases
    known = np.zeros((count, memory + 1, outputs), dtype=bool)
    for n, (own, buffer, delay) in enumerate(zip(nodes.outputs, nodes.buffers, delays)):
        if turns is None:
            known[0, delay:, list(own)] = True
            continue
        if cycle:
            for i, e in product(range(count), range(delay, memory + 1)):
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
