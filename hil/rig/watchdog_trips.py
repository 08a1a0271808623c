"""How often the watchdog stops a run that its network starves of commands, by its own losses and by cuts on the time line."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hil.experiment import Experiment
from hil.rig.delay_chains import Chains, begun
from hil.rig.schedules import as_one, cuts_of
from transport.laws import AgeChain

STOPPED = 1e-3
"""Share of the runs that the watchdog may stop without being named."""
NEGLIGIBLE, MOST_SLOTS = 1e-12, 100_000


def watchdog_chance(chains: Chains, experiment: Experiment, d_max: int) -> float:
    """Return the probability that a run ends because the actuator holds no packet that its rows cover for too many slots.

    Args:
        chains: of the rig.
        experiment: with its watchdog and its number of slots.
        d_max: largest delay that a packet has a row for; until that slot nothing is missing.
    """
    chain, initial, most = chains.ca, begun((chains.applied,)), experiment.limits.watchdog_slots
    if chain is None or initial is None or not chain.holds.any() or most > experiment.slots:
        return 0.0
    waits, goes_on, alive = chain.holds, 1.0, np.array([initial])  # a row for every number of slots without one so far
    for k in range(1, slots := min(experiment.slots, MOST_SLOTS)):
        before, alive = alive, alive @ chain.matrix
        if k > d_max:
            alive = np.vstack([np.where(waits, 0.0, alive).sum(axis=0), np.where(waits, alive, 0.0)])[:most]
            alive = alive[: int(np.flatnonzero(alive.sum(axis=1) > NEGLIGIBLE).max(initial=0)) + 1]
        share = float(alive.sum())
        goes_on, alive = goes_on * share, alive / max(share, NEGLIGIBLE)
        if goes_on < STOPPED:
            break
        if k > d_max and alive.shape == before.shape and np.abs(alive - before).max() < NEGLIGIBLE:  # from here on alike
            goes_on *= share ** (slots - 1 - k)
            break
    return max(0.0, 1.0 - goes_on)


def chance_behind_cuts(chains: Chains, experiment: Experiment, d_max: int) -> float:
    """Return about the probability that the watchdog trips by cuts of the way to the actuator, 0 over an age law.

    So many slots are without a command: those before a cut that lacked one already, the cut, and those behind it in which none
    that was sent since its end has come. What was sent before its end counts as lost.

    Args:
        chains: of the rig.
        experiment: with its watchdog and its faults.
        d_max: largest delay that a packet has a row for.
    """
    law, cuts = chains.applied.ages, as_one(cuts_of(experiment))
    if not cuts or not isinstance(law, AgeChain):
        return 0.0
    ages, matrix, most = np.array(law.mode_ages), law.transition_matrix(), experiment.limits.watchdog_slots

    def lacks(slots: int, oldest: Callable[[int], int]) -> NDArray[np.float64]:
        weights, found = law.initial_law(), [1.0]
        for k in range(slots):
            weights = np.where(ages > oldest(k), weights if k == 0 else weights @ matrix, 0.0)
            found.append(float(weights.sum()))
        return np.array(found)

    before, behind = lacks(most, lambda k: d_max), lacks(most, lambda k: min(k, d_max))
    exactly, left = before[:-1] - before[1:], [np.arange(most - (end - first), 0, -1) for first, end in cuts]
    return min(1.0, sum(float(exactly[: len(each)] @ behind[each] + before[len(each)]) for each in left))
