"""What a design is asked to solve: the loop that will run, as plain matrices, chains and rates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from design.controllers import LoopModel

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from design.historical_data.lifted_loop import DelayedPlant
    from design.processes.delay_chain import DelayChain
    from design.processes.semi_markov import FaultDetection, SemiMarkov
    from design.semi_markov_loop.system import DelayedJumpSystem, JumpSystem


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignTask:
    """The loop for which gains are wanted.

    Args:
        model: the nominal plant at the sample period, and the largest delays.
        sc, ca: the delay chains of both directions; None where a law has none.
        sc_nodes: several sensor nodes: the delay chain of each; empty where a law has none, or for one node.
        jump_system: the modes of a plant that jumps, None of one that does not.
        jump_process: how its modes change.
        delayed_plant: the plant of Chapter 5, None of one that does not measure its state.
        initial_state: x(0) of that plant, shape (n,).
        folder: where relative file names begin.
        chainless: what keeps the network from having chains, in words; empty where nothing does.
    """

    model: LoopModel
    sc: DelayChain | None = None
    sc_nodes: tuple[DelayChain, ...] = ()
    ca: DelayChain | None = None
    jump_system: JumpSystem | DelayedJumpSystem | None = None
    jump_process: SemiMarkov | FaultDetection | None = None
    delayed_plant: DelayedPlant | None = None
    initial_state: NDArray[np.float64] | None = None
    folder: str = "."
    chainless: str = ""
