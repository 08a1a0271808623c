"""Numbers of many seeded runs of a loop on the rig, all at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hil.compose.loop import Loop
from hil.measure.many import Many, ManyView
from hil.sweeps.lockstep import chunk_runs, run_together, view_of_many

Numbers = Callable[[ManyView], Sequence[Many]]


def numbers_of(loop: Loop, seeds: Sequence[int], columns: int, numbers: Numbers) -> Many:
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
    size = chunk_runs(loop)
    for at in range(0, len(seeds), size):
        together = run_together(loop, seeds[at : at + size])
        if together.known.any():
            found[at : at + size][together.known] = np.stack(numbers(view_of_many(loop, together)), axis=1)
    return found
