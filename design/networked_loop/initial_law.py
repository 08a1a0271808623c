"""The distribution of the mode at the impulse of an H2 norm, where none is given.

A plain delay chain has one mode per delay, and the thesis takes them as equally likely. Where several modes have one
delay (a semi-Markov law counts its slots) their number depends on where a tail is cut, and with it every norm that
weighs them equally; there the stationary distribution is taken, which no cut moves.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from design.processes.delay_chain import Array, DelayChain


def default_initial(sc: DelayChain, ca: DelayChain, modes: list[tuple[int, int, int]]) -> Array:
    """Return the distribution over the joint modes (S-C mode, C-A mode, C-A mode before or -1), (N,).

    Args:
        sc, ca: the delay chains.
        modes: the joint modes.
    """
    if initial_law(sc, ca) == "uniform":
        return np.full(len(modes), 1.0 / len(modes))
    s, c, before = np.array(modes, dtype=np.int64).T
    of_ca = ca.stationary[c] if before[0] < 0 else ca.stationary[before] * ca.matrix[before, c]
    weights = sc.stationary[s] * of_ca
    return np.asarray(weights / weights.sum(), dtype=np.float64)


def initial_law(sc: DelayChain, ca: DelayChain) -> Literal["uniform", "stationary"]:
    """Return the name of the default distribution.

    >>> initial_law(DelayChain(transition=[[1.0]]), DelayChain(transition=[[1.0]]))
    'uniform'
    """
    return "uniform" if sc.is_plain and ca.is_plain else "stationary"
