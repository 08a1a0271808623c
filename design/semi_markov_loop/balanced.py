"""A sampled jump loop in units of its states and inputs in which its matrices are of one size: no verdict depends on units.

    x = D x',  u = G u',  diagonal and powers of 2, so that nothing is rounded: the balance of [A, B; K / T, 0] in all modes.

Reference: Parlett and Reinsch, Balancing a matrix for calculation of eigenvalues and eigenvectors, Numer. Math. 13 (1969).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.linalg import matrix_balance

from design.controllers.scheduled_gain import ScheduledGain
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem, NormBounded

System = JumpSystem | DelayedJumpSystem
ENOUGH: Final = 4.0
"""Other units are taken where they make the largest matrix smaller by this factor."""


def balanced(system: System, gain: ScheduledGain, period_s: float) -> tuple[System, ScheduledGain]:
    """The same loop in other units, or as it is where these are good enough.

    Args:
        system: matrices; what it says of z and w is left out of account.
        gain: fits the system.
        period_s: T (s).
    """
    n, m = system.states, system.inputs
    sizes = np.zeros((n + m, n + m))
    sizes[:n, :n], sizes[:n, n:] = np.abs(system.a).max(axis=0), np.abs(system.b).max(axis=0)
    sizes[n:, :n] = np.abs(gain.gain).max(axis=(0, 1)) / period_s
    smaller, (units, _) = matrix_balance(sizes, permute=False, separate=True)
    if np.linalg.norm(sizes) < ENOUGH * np.linalg.norm(smaller):
        return system, gain
    x, u = units[:n], units[n:]
    state, given = x / x[:, None], u / x[:, None]
    gain = replace(gain, gain=gain.gain * (x / u[:, None]))
    if isinstance(system, DelayedJumpSystem):
        return replace(system, a=system.a * state, ad=system.ad * state, b=system.b * given), gain
    free, sensors = system.uncertainty, None if system.sensors is None else system.sensors * state
    if isinstance(free, NormBounded):
        free = replace(free, e=free.e / x[:, None], fa=free.fa * x, fb=free.fb * u)
    elif free is not None:
        free = replace(free, da=free.da * state, db=free.db * given)
    return replace(system, a=system.a * state, b=system.b * given, uncertainty=free, sensors=sensors), gain
