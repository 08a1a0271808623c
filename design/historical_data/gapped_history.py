"""Gains over a history with gaps as the theory takes them: one set for each phase of a chain of outcomes.

A phase says which of the last packets came, and so which samples are known: over a round robin that loses packets
(`gapped_gains`), and over any schedule that loses or draws (`window_chain`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import replace

from design.controllers.sensor_nodes import PacketWindow, SensorNodes, Uses, window_of
from design.errors import FieldError
from design.historical_data import Array
from design.historical_data.sensor_schedule import Mask, lossy, phase_chain, phases_at_start, undecided_because, with_lost_turns

MOST_PHASES = 512
MOST_NUMBERS = 700_000  # in the matrices of all phases; a certificate of these takes some seconds


class PhaseGains(Struct, frozen=True, kw_only=True, eq=False):
    """Gains of every phase, and the chain of the phases.

    Args:
        gains: (phases, memory + 1, p, n); one column more, on what is held, where ``renewed`` is given.
        transition: chain of the phases; None for the cycle.
        start: probability of each phase in slot 0.
        renewed: (phases, n), whether what is held becomes the oldest sample; None where nothing is held.
    """

    gains: Array
    transition: Array | None
    start: Array
    renewed: npt.NDArray[np.bool_] | None = None


def gaps_undecided(nodes: SensorNodes, memory: int, delayed: int = 0) -> str:
    """Return what about a history with lost packets the theory does not know, empty if nothing.

    Args:
        nodes: the sensor nodes, with constant delays, on a medium that loses packets.
        memory: tau, the oldest sample that the controller uses.
        delayed: the largest state delay of the plant.
    """
    turns, delays = nodes.turns, [delay for delay in nodes.delays if delay is not None]
    if turns is None or not turns.order or len(delays) < len(nodes.delays):
        return "the theory knows a history with lost packets where nodes take turns in a fixed order, not a bus that loses frames"
    length = memory + 1 - min(delays)
    phases = len(turns.order) * 2**length
    if phases > MOST_PHASES:
        return (
            f"which of the last {length} packets got lost decides what a history has: {phases} phases with the turns, "
            f"and the theory takes at most {MOST_PHASES}"
        )
    order = sum(map(len, nodes.outputs)) * (max(memory, delayed) + 2)
    if phases * order**2 > MOST_NUMBERS:
        return (
            f"a history with lost packets has {phases} phases and {order} states: {phases * order**2} numbers, "
            f"and the theory takes at most {MOST_NUMBERS}"
        )
    return ""


def gap_window(nodes: SensorNodes, memory: int) -> PacketWindow:
    """Return the outcomes that decide what is known; its slots are those in which the packets come that take the shortest time.

    Args:
        nodes: the sensor nodes, for which `gaps_undecided` is empty.
        memory: tau, the oldest sample that the controller uses.

    Raises:
        ValueError: nodes that are not in a fixed order, or too many phases.
    """
    unknown, turns = gaps_undecided(nodes, memory), nodes.turns
    if unknown or turns is None:
        raise FieldError("nodes", unknown)
    late = min(delay or 0 for delay in nodes.delays)
    return PacketWindow(turns=replace(turns, phase=(turns.phase - late) % len(turns.order)), length=memory + 1 - late)


def gapped_gains(K: Array, nodes: SensorNodes) -> PhaseGains:
    r"""Return the gains that act on the plant's own past, by outcome.

    The controller keeps the samples of the last tau slots and the newest one of each node. A gain on x_l(k - j) that is missing
    acts on the newest sample before it; none is left where a packet of the node has come since, and the gain then acts on 0. The
    outcomes of the packets of these slots are the phase: they say which samples are known. A node that none of them brought is
    held from its last sample, of any age; it is an entry h_l of the state, taken from the oldest sample as its packet leaves the
    window:

    .. math:: h_l(k+1) = x_l(k - \tau) \ \text{if slot } k - \tau \text{ was node}(l)\text{'s and its packet came, else } h_l(k)

    So finitely many phases are exact, however many packets in a row get lost.

    Args:
        K: (turns, memory + 1, p, n), as the controller has them.
        nodes: the sensor nodes, for which `gaps_undecided` is empty.

    Raises:
        ValueError: nodes that are not in a fixed order, or too many phases.
    """
    memory, window, delays = K.shape[1] - 1, gap_window(nodes, K.shape[1] - 1), [delay or 0 for delay in nodes.delays]
    late, count = min(delays), len(window.turns.order)
    gains = np.zeros((window.phases, memory + 2, *K.shape[2:]))
    renewed = np.zeros((window.phases, K.shape[3]), dtype=bool)
    for i in range(window.phases):
        received = window.outcomes(i)
        for node, own in enumerate(nodes.outputs):
            ages = [late + e for e, sender in enumerate(received) if sender == node and late + e >= delays[node]]
            known = {j for age in ages for j in range(age, age + nodes.buffers[node])}
            for j in range(memory + 1):
                at = next((older for older in range(j, memory + 1) if older in known), None)
                if at is None and not ages:
                    at = memory + 1
                if at is not None:
                    gains[i, at][:, list(own)] += K[(i + late) % count, j][:, list(own)]
            renewed[i, list(own)] = received[-1] == node
    return PhaseGains(gains=gains, transition=window_chain(window), start=window_start(window), renewed=renewed)


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
    if uses == "history" and lossy(nodes.turns):
        return gapped_gains(K, nodes)
    full = with_lost_turns(K, nodes).astype(np.float64)
    return PhaseGains(gains=full, transition=phase_chain(nodes), start=phases_at_start(nodes, uses))


def gains_undecided(K: Array, nodes: SensorNodes, uses: Uses, delayed: int) -> str:
    """Return what about gains over these nodes is not known to the theory, empty if nothing; triggers are for the caller.

    Args:
        K: (phases, memory + 1, p, n), as the controller has them.
        nodes: the sensor nodes.
        uses: what the controller looks at.
        delayed: the largest state delay of the plant.
    """
    unknown = undecided_because(nodes)
    if unknown:
        return unknown
    if uses == "last-packets" and nodes.turns is not None:
        return window_undecided(nodes, window_of(nodes.turns, len(K)))
    return gaps_undecided(nodes, K.shape[1] - 1, delayed) if uses == "history" and lossy(nodes.turns) else ""
