"""What a network law states of its modes: their transitions, their shares of the slots, and how long they last."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from transport.laws.protocols import LongRunLaw, MarkovModes, RecordedLaw, SemiMarkovLaw
from transport.laws.sojourn import mean_sojourn
from transport.laws.stochastic_matrix import mean_holding, stationary_row

Numbers = NDArray[np.float64]


def mode_transitions(law: object) -> Numbers | None:
    """Return the transition matrix of a law's modes, (n, n); None where they are no Markov chain.

    Args:
        law: a law of `MarkovModes`: the delays of an age law, the channel of a packet law.
    """
    if isinstance(law, RecordedLaw | SemiMarkovLaw) or not isinstance(law, MarkovModes):
        return None
    return np.asarray(law.transition_matrix(), dtype=np.float64)


def mode_shares(law: object) -> Numbers | None:
    """Return the share of slots in every mode, (n,); None for a law that does not say.

    Raises:
        ValueError: it is not unique, because the chain has several closed classes.
    """
    if isinstance(law, LongRunLaw):
        return np.asarray(law.stationary(), dtype=np.float64)
    if isinstance(law, SemiMarkovLaw):
        weights = stationary_row(law.matrix) * np.array([mean_sojourn(s) for s in law.sojourn])
        return np.asarray(weights / weights.sum(), dtype=np.float64)
    matrix = mode_transitions(law)
    return None if matrix is None else stationary_row(matrix)


def mode_bursts(law: object) -> Numbers | None:
    """Return the mean number of slots that a mode lasts, (n,); None for a law that does not say."""
    if isinstance(law, LongRunLaw):
        return np.asarray(law.mean_bursts(), dtype=np.float64)
    if isinstance(law, SemiMarkovLaw):
        return np.array([mean_sojourn(s) for s in law.sojourn])
    matrix = mode_transitions(law)
    return None if matrix is None else mean_holding(matrix)
