"""What a law says of its modes: the Markov chain of the age that a receiver measures, and how often and how long each mode lasts.

A loop over an age law runs with that chain.

A receiver keeps the newest packet, so that what it measures is min(age drawn, age measured before + 1). Where the law's
age grows by at most one per slot, that is the age drawn; where it may grow faster, (mode drawn, age measured) is a Markov
chain with more states.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from transport.laws import ChainLaw, InitialLaw, LongRunLaw, MarkovModes, RecordedLaw, SemiMarkovLaw
from transport.laws.stochastic_matrix import mean_holding, stationary_row

Matrix = NDArray[np.float64]


class DelayStates(NamedTuple):
    """The chain of the measured age.

    Attributes:
        matrix: (N, N) row-stochastic.
        ages: age measured in every state, (N,), slots.
        slots: slots spent in the law's mode, this one included, (N,); 1 for laws without sojourns.
        low, high: entrywise bounds of the matrix, (N, N); the matrix itself where it is exact.
        has_gaps: whether the law draws ages that no receiver measures.
        initial: law of the state in slot 0, (N,).
        stays: limit of the probability to stay, (N,), in a state that stands for all longer stays; 0 where it is not known.
    """

    matrix: Matrix
    ages: NDArray[np.int64]
    slots: NDArray[np.int64]
    low: Matrix
    high: Matrix
    has_gaps: bool
    initial: Matrix
    stays: Matrix


def delay_states(law: object, least: int = 1, *, drawn: bool = False) -> DelayStates | None:
    """Return the chain of the age that a receiver measures under an age law; None for a law that states no chain.

    Args:
        law: a `SemiMarkovLaw` or a `ChainLaw`.
        least: lengths of stay in a mode that have states of their own, whatever the hazard.
        drawn: the chain of the age that is drawn, in the place of the measured one.

    >>> from transport.laws.age import IidAge
    >>> delay_states(IidAge(probabilities=(0.5, 0.3, 0.2), allow_gaps=True)).matrix.tolist()
    [[0.5, 0.5, 0.0], [0.5, 0.3, 0.2], [0.5, 0.3, 0.2]]
    """
    if isinstance(law, RecordedLaw):
        return None
    if isinstance(law, SemiMarkovLaw):
        from transport.laws.semi_markov import augmented_chain  # loaded where a mode lasts

        chain = augmented_chain(law, least=least)
        ages, slots = np.array(law.mode_ages, dtype=np.int64)[chain.modes], chain.slots
        matrix, low, high, stays = chain.matrix, chain.low, chain.high, chain.stays
    elif isinstance(law, ChainLaw):
        matrix = low = high = np.array(law.transition_matrix(), dtype=np.float64)
        ages, slots = np.array(law.mode_ages, dtype=np.int64), np.ones(len(matrix), dtype=np.int64)
        stays = np.zeros(len(matrix))
    else:
        return None
    begin = _initial(law, matrix, slots)
    gaps = bool((high > 0.0)[ages[None, :] > ages[:, None] + 1].any())
    if gaps and not drawn:
        matrix, low, high, ages, origin = _measured(matrix, low, high, ages)
        # a mode that is not left comes to measure its own age: these are the first states
        slots, (begin, stays) = slots[origin], (np.append(own, np.zeros(len(ages) - len(own))) for own in (begin, stays))
    return DelayStates(matrix, ages, slots, low, high, gaps, begin, stays)


def measured_ages(ages: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return min(drawn, measured before + 1) of a record of drawn ages, (slots,).

    >>> measured_ages(np.array([0, 2, 2, 0])).tolist()
    [0, 1, 2, 0]
    """
    slots = np.arange(len(ages))
    return np.asarray(slots - np.maximum.accumulate(slots - ages), dtype=np.int64)


def _initial(law: object, matrix: Matrix, slots: NDArray[np.int64]) -> Matrix:
    """Law of the drawn state in slot 0."""
    if not isinstance(law, InitialLaw) or law.initial == "stationary":
        try:
            return stationary_row(matrix)
        except ValueError:  # several closed classes, and nothing said of where it begins
            return np.full(len(matrix), 1.0 / len(matrix))
    own = np.zeros(len(matrix))
    own[slots == 1] = law.initial_law()  # a sojourn begins
    return own


def _measured(
    matrix: Matrix, low: Matrix, high: Matrix, ages: NDArray[np.int64]
) -> tuple[Matrix, Matrix, Matrix, NDArray[np.int64], NDArray[np.int64]]:
    """States (drawn state, measured age), and which drawn state each is; states that nothing distinguishes are one."""
    same: dict[tuple[bytes, bytes, bytes], int] = {}
    kind = [same.setdefault((matrix[i].tobytes(), low[i].tobytes(), high[i].tobytes()), i) for i in range(len(ages))]
    states = [(i, int(age)) for i, age in enumerate(ages)]
    index: dict[tuple[int, int], int] = {}
    for at, (i, age) in enumerate(states):
        index.setdefault((kind[i], age), at)
    steps: list[tuple[int, int, int]] = []  # state, drawn state that follows, state that follows
    for at, (i, age) in enumerate(states):  # grows on the way
        for j in np.flatnonzero(high[i]).tolist():
            measured = min(int(ages[j]), age + 1)
            following = j if measured == ages[j] else index.get((kind[j], measured), -1)
            if following < 0:
                following = index[kind[j], measured] = len(states)
                states.append((j, measured))
            steps.append((at, j, following))
    origin = np.array([i for i, _ in states], dtype=np.int64)
    bounds = []
    for chain in (matrix, low, high):
        grown = np.zeros((len(states), len(states)))
        for at, j, following in steps:
            grown[at, following] += chain[origin[at], j]
        bounds.append(np.minimum(grown, 1.0))
    return bounds[0], bounds[1], bounds[2], np.array([age for _, age in states], dtype=np.int64), origin


def mode_transitions(law: object) -> Matrix | None:
    """Return the transition matrix of a law's modes, (n, n); None where they are no Markov chain.

    Args:
        law: a law of `MarkovModes`: the delays of an age law, the channel of a packet law.
    """
    if isinstance(law, RecordedLaw | SemiMarkovLaw) or not isinstance(law, MarkovModes):
        return None
    return np.asarray(law.transition_matrix(), dtype=np.float64)


def long_run(law: object) -> tuple[Matrix, Matrix] | None:
    """Return the share of slots in every mode, and the mean number of slots that it lasts, (n,); None where a law does not say.

    Raises:
        ValueError: the shares are not unique, because the chain has several closed classes.
    """
    if isinstance(law, LongRunLaw):
        return np.asarray(law.stationary(), dtype=np.float64), np.asarray(law.mean_bursts(), dtype=np.float64)
    if isinstance(law, SemiMarkovLaw):
        from transport.laws.semi_markov import shares_and_stays  # loaded where a mode lasts

        return shares_and_stays(law)
    matrix = mode_transitions(law)
    return None if matrix is None else (stationary_row(matrix), mean_holding(matrix))
