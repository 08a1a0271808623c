"""The Markov process in the place of a semi-Markov one: constant rates with the same mean sojourns (1.1, 4.2, 8.1)."""

from __future__ import annotations

import numpy as np

from design.processes.rates import constant_rate
from design.processes.semi_markov import SemiMarkov

POINTS = 100_000
"""Of the sojourn's distribution, over which it is averaged."""


def mean_sojourns(process: SemiMarkov) -> list[float]:
    """Return the mean sojourn of every mode, s."""
    shares = (np.arange(POINTS) + 0.5) / POINTS
    return [float(process.sojourn(mode, -np.log1p(-shares)).mean()) for mode in range(process.modes)]


def markov_approximation(process: SemiMarkov) -> SemiMarkov:
    """Return the Markov process of two modes with the mean sojourns of another.

    Raises:
        ValueError: it has not two modes, between which a rate alone does not say where a jump leads.
    """
    if process.modes != 2:
        raise ValueError(f"process: {process.modes} modes, expected 2")
    out, back = (constant_rate(1.0 / mean) for mean in mean_sojourns(process))
    return SemiMarkov(rates=((None, out), (back, None)))
