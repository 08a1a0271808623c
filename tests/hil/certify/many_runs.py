"""States and commands of many runs of a loop, in lockstep where it can be: the bits are those of one run after another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.log.topics import APPLIED, STATE
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from hil.sweeps.lockstep import run_batch, supports_batch

Array = NDArray[np.float64]


def many_runs(loop: Loop, runs: int) -> tuple[dict[str, Array], Array]:
    """Return every state by name, and the first input as applied, (slots, runs) each."""
    names = [str(signal.name) for signal in loop.experiment.plant.states]
    if supports_batch(loop):
        together = run_batch(loop, range(runs), (STATE.name,))
        if together.known.all() and together.states is not None:
            return dict(zip(names, together.states)), together.inputs[0]
    found = [simulate(loop, seed, [STATE.name, APPLIED.name]).arrays for seed in range(runs)]
    states = {name: np.column_stack([run[STATE.name][name] for run in found]) for name in names}
    command = str(loop.experiment.plant.inputs[0].name)
    return states, np.column_stack([run[APPLIED.name][command] for run in found])
