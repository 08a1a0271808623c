r"""The last packets over a schedule that loses or draws, as the theory takes them: the chain of the windows of outcomes.

With the outcomes of w slots as the phase, the loop is jump-linear for every w: what each phase knows is fixed. Over random turns
a lost packet hides whose turn it was; the chain then stays exact for turns that are independent.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from design.controllers.packet_window import PacketWindow
from design.controllers.sensor_nodes import SensorNodes
from design.historical_data.information import Mask

Array = npt.NDArray[np.float64]


def window_mask(nodes: SensorNodes, window: PacketWindow, memory: int) -> Mask:
    """Return which gains may differ from zero, (phases, memory + 1, outputs).

    Args:
        nodes: the sensor nodes, with one constant delay.
        window: the outcomes that are told apart.
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
    """Return the transition matrix of the phases, (phases, phases)."""
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
    heard = [(1.0 - turns.loss) * p for p in row]
    return [*heard, turns.loss] if turns.loss else heard


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
