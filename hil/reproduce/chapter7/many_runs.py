"""Numbers of many seeded runs of a loop on the rig, all at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hil.compose.loop import Loop
from hil.measure.batch_measure import BatchValues, BatchView
from hil.sweeps.lockstep import run_batch, runs_per_batch, view_of_batch

Numbers = Callable[[BatchView], Sequence[BatchValues]]


def numbers_of(loop: Loop, seeds: Sequence[int], columns: int, numbers: Numbers) -> BatchValues:
    """Numbers of every run.

    Args:
        loop: a loop that can be run in lockstep; the numbers of a run are those that it has alone, bit for bit.
        seeds: one run each.
        columns: how many numbers a run has.
        numbers: gives them from a view of runs, (runs,) each.

    Returns:
        (seeds, columns); infinite in runs that safety stops or that leave all bounds.
    """
    found = np.full((len(seeds), columns), np.inf)
    size = runs_per_batch(loop)
    for at in range(0, len(seeds), size):
        together = run_batch(loop, seeds[at : at + size])
        if together.known.any():
            found[at : at + size][together.known] = np.stack(numbers(view_of_batch(loop, together)), axis=1)
    return found
