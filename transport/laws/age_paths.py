"""Paths of many age processes at once: the ages that `draw` gives one by one, from the same streams, as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from transport.laws.stochastic_matrix import Row, cumulative

Ages = NDArray[np.int32]


def uniforms_of_many(rngs: Iterable[np.random.Generator], runs: int, slots: int) -> NDArray[np.float64]:
    """Return the first uniform numbers of [0, 1) of many streams, (slots, runs)."""
    (first,) = several_of_many(rngs, runs, slots, 1)
    return np.asarray(first)


def several_of_many(rngs: Iterable[np.random.Generator], runs: int, slots: int, numbers: int) -> NDArray[np.float64]:
    """Return so many uniform numbers of [0, 1) of every slot of many streams, (numbers, slots, runs)."""
    drawn = np.empty((runs, slots, numbers))
    for row, rng in zip(drawn, rngs, strict=True):
        rng.random(out=row)
    return np.ascontiguousarray(np.moveaxis(drawn, (2, 1), (0, 1)))


def chain_ages(first: Row, rows: Sequence[Row], ages: Sequence[int], uniforms: NDArray[np.float64]) -> Ages:
    """Return the ages of many Markov chains, (slots, runs): the mode that `bisect_right` finds for every uniform number.

    Args:
        first: law of the mode in slot 0, (modes,).
        rows: transition probabilities, (modes, modes).
        ages: age of every mode, (modes,).
        uniforms: numbers of [0, 1), (slots, runs).
    """
    bounds: NDArray[np.float64] = np.array([cumulative(row)[:-1] for row in rows]).reshape(len(rows), -1).T.copy()
    modes = np.zeros(uniforms.shape, dtype=np.intp)
    if not len(uniforms):
        return np.zeros(uniforms.shape, dtype=np.int32)
    for share in cumulative(first)[:-1]:
        modes[0] += uniforms[0] >= share
    for k in range(1, len(uniforms)):
        before, now, u = modes[k - 1], modes[k], uniforms[k]
        for bound in bounds:
            now += u >= bound.take(before)
    return np.array(ages, dtype=np.int32).take(modes)
