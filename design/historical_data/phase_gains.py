"""Gains over historical data as the theory takes them: one set for each phase of a chain, whatever the controller looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.controllers.packet_window import window_of
from design.controllers.sensor_nodes import SensorNodes, Uses
from design.historical_data.gapped_history import gapped_gains, gaps_undecided
from design.historical_data.lifted_loop import Array
from design.historical_data.packet_windows import window_chain, window_start, window_undecided
from design.historical_data.sensor_schedule import lossy, phase_chain, phases_at_start, undecided_because, with_lost_turns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhaseGains:
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
        gapped = gapped_gains(K, nodes)
        chain, start = window_chain(gapped.window), window_start(gapped.window)
        return PhaseGains(gains=gapped.gains, transition=chain, start=start, renewed=gapped.renewed)
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
