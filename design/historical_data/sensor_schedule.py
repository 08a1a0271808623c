"""Sensor nodes of a rig as the theory of Chapter 5 takes them: what is known in each phase, and the chain of the phases.

Over a cycle the phase is the turn, and a turn whose packet may get lost has a twin in which nothing came. Over random turns the
phase is the node whose packet came.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.controllers.sensor_nodes import PacketWindow, SensorNodes, Turns, Uses, window_of
from design.errors import FieldError
from design.historical_data import Array, cycle

Mask = npt.NDArray[np.bool_]


class PhaseGains(Struct, frozen=True, kw_only=True, eq=False):
    """Gains of every phase, and the chain of the phases.

    Args:
        gains: (phases, memory + 1, p, n); one column more, on what is held, where ``renewed`` is given.
        transition: chain of the phases; None for the cycle.
        start: probability of each phase in slot 0.
        renewed: (phases, n), whether what is held becomes the oldest sample; None where nothing is held.
        ages: (phases,), age of the command that acts, -1 where the one before acts on; None where it is the same in all.
    """

    gains: Array
    transition: Array | None
    start: Array
    renewed: npt.NDArray[np.bool_] | None = None
    ages: npt.NDArray[np.int64] | None = None


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


def window_mask(nodes: SensorNodes, window: PacketWindow, memory: int) -> Mask:
    """Return which gains may differ from zero, (phases, memory + 1, outputs).

    Args:
        nodes: the sensor nodes, with one constant delay.
        window: the outcomes that are distinguished.
        memory: tau, the oldest sample that the controller uses.
    """
    delay = nodes.delays[0] or 0
    known = np.zeros((window.phases, memory + 1, sum(map(len, nodes.outputs))), dtype=bool)
    for i in range(window.phases):
        for e, node in enumerate(window.outcomes(i)):
            if node is not None:
                known[i, delay + e : delay + e + nodes.buffers[node], list(nodes.outputs[node])] = True
    return known


def window_chain(window: PacketWindow) -> Array:
    """Return the transition matrix of the phases, (phases, phases).

    With the outcomes of w slots as the phase, the loop is jump-linear for every w: what each phase knows is fixed. Over random
    turns a lost packet hides whose turn it was; the chain then stays exact for turns that are independent.
    """
    turns, base, count = window.turns, window.base, max(len(window.turns.order), 1)
    chain = np.zeros((window.phases, window.phases))
    for i in range(window.phases):
        digits, turn = i // count, i % count
        older = digits * base % base**window.length
        for outcome, share in enumerate(_next(window, i)):
            chain[i, (turn + 1) % count + count * (older + outcome) if turns.order else older + outcome] += share
    return chain


def _next(window: PacketWindow, phase: int) -> list[float]:
    turns = window.turns
    if turns.order:
        return [1.0 - turns.loss, turns.loss]
    last = window.outcomes(phase)[0]
    row = turns.transition[0 if last is None else last]  # rows are alike where a loss hides the last node
    received = [(1.0 - turns.loss) * p for p in row]
    return [*received, turns.loss] if turns.loss else received


def window_start(window: PacketWindow) -> Array:
    """Return the distribution of the phases in slot 0, when packets take no slot."""
    turns, start = window.turns, np.zeros(window.phases)
    if turns.order:
        start[turns.phase] = 1.0 - turns.loss
        start[turns.phase + len(turns.order)] = turns.loss
        return start
    shares = [(1.0 - turns.loss) * p for p in turns.initial] + ([turns.loss] if turns.loss else [])
    for outcome, share in enumerate(shares):
        start[sum(outcome * window.base**e for e in range(window.length))] += share
    return start


def window_undecided(nodes: SensorNodes, window: PacketWindow) -> str:
    """Return what about the last packets the theory does not know, empty if nothing."""
    rows = window.turns.transition
    if rows and window.turns.loss and any(row != rows[0] for row in rows):
        return "a lost packet hides whose turn it was: the theory knows the last packets of random turns that are independent"
    if any(nodes.delays):
        return "the theory knows the last packets where they take no slot"
    return ""


def phase_gains(K: Array, nodes: SensorNodes, uses: Uses) -> PhaseGains:
    """Return the gains of every phase.

    Args:
        K: (phases, memory + 1, p, n), as the controller has them.
        nodes: the sensor nodes, for which `gains_undecided` is empty.
        uses: what the controller looks at.
    """
    if uses == "last-packets" and nodes.turns is not None:
        window = window_of(nodes.turns, len(K))
        return PhaseGains(gains=K, transition=window_chain(window), start=window_start(window))
    full = with_lost_turns(K, nodes).astype(np.float64)
    return PhaseGains(gains=full, transition=phase_chain(nodes), start=phases_at_start(nodes, uses))


def gains_undecided(K: Array, nodes: SensorNodes, uses: Uses) -> str:
    """Return what about gains over these nodes is not known to the theory, empty if nothing; triggers are for the caller.

    Args:
        K: (phases, memory + 1, p, n), as the controller has them.
        nodes: the sensor nodes.
        uses: what the controller looks at.
    """
    unknown = undecided_because(nodes)
    if unknown:
        return unknown
    if uses == "last-packets" and nodes.turns is not None:
        return window_undecided(nodes, window_of(nodes.turns, len(K)))
    return "a history with lost packets has more phases than turns" if uses == "history" and lossy(nodes.turns) else ""
