r"""A history with gaps, as the theory takes it: what is known where packets of a round robin get lost, and what is held.

The controller keeps the samples of the last tau slots and the newest one of each node. A gain on x_l(k - j) that is missing acts
on the newest sample before it; none is left where the node has been heard since, and the gain then acts on 0. The outcomes of the
packets of these slots are the phase: they say which samples are known. A node that none of them has brought is held from its last
sample, of any age; it is an entry h_l of the state, taken from the oldest sample as its packet leaves the window:

.. math:: h_l(k+1) = x_l(k - \tau) \ \text{if slot } k - \tau \text{ was node}(l)\text{'s and its packet came, else } h_l(k)

So finitely many phases are exact, however many packets in a row get lost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from design.controllers.packet_window import PacketWindow
from design.controllers.sensor_nodes import SensorNodes
from design.errors import FieldError
from design.historical_data.lifted_loop import Array

MOST_PHASES = 512
MOST_NUMBERS = 700_000  # in the matrices of all phases; a certificate of these takes some seconds


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GappedGains:
    """Gains over a history with gaps, one set for each outcome of the packets.

    Args:
        gains: (phases, memory + 2, p, n): on x(k), ..., x(k - memory), and on what is held from before.
        renewed: (phases, n), whether what is held becomes the oldest sample.
        window: the outcomes that are told apart; its slots are those in which the packets come that take the shortest time.
    """

    gains: Array
    renewed: npt.NDArray[np.bool_]
    window: PacketWindow


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


def gapped_gains(K: Array, nodes: SensorNodes) -> GappedGains:
    """Return the gains that act on the plant's own past, by outcome.

    Args:
        K: (turns, memory + 1, p, n), as the controller has them.
        nodes: the sensor nodes, for which `gaps_undecided` is empty.

    Raises:
        ValueError: nodes that are not in a fixed order, or too many phases.
    """
    memory, turns = K.shape[1] - 1, nodes.turns
    unknown = gaps_undecided(nodes, memory)
    if unknown or turns is None:
        raise FieldError("nodes", unknown)
    delays = [delay or 0 for delay in nodes.delays]
    late, count = min(delays), len(turns.order)
    window = PacketWindow(turns=replace(turns, phase=(turns.phase - late) % count), length=memory + 1 - late)
    gains = np.zeros((window.phases, memory + 2, *K.shape[2:]))
    renewed = np.zeros((window.phases, K.shape[3]), dtype=bool)
    for i in range(window.phases):
        heard = window.outcomes(i)
        for node, own in enumerate(nodes.outputs):
            ages = [late + e for e, sender in enumerate(heard) if sender == node and late + e >= delays[node]]
            known = {j for age in ages for j in range(age, age + nodes.buffers[node])}
            for j in range(memory + 1):
                at = next((older for older in range(j, memory + 1) if older in known), None)
                if at is None and not ages:
                    at = memory + 1
                if at is not None:
                    gains[i, at][:, list(own)] += K[(i + late) % count, j][:, list(own)]
            renewed[i, list(own)] = heard[-1] == node
    return GappedGains(gains=gains, renewed=renewed, window=window)
