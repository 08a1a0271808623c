"""Probability rows and row-stochastic matrices: checked with the entry named, analysed, drawn from for many runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from transport.draws import cumulative
from transport.errors import FieldError

Row = tuple[float, ...]
Ages = NDArray[np.int32]
SUM_TOLERANCE = 1e-9


def checked_row(path: str, row: object, size: int | None = None) -> Row:
    """Return a probability row as floats.

    Args:
        path: field path that starts every message, e.g. "matrix[2]".
        row: sequence of numbers.
        size: expected number of entries; any number >= 1 by default.

    Raises:
        ValueError: no sequence of numbers, wrong size, an entry that is no probability, a sum other than 1 (tolerance
            1e-9).

    >>> checked_row("matrix[2]", [0.5, 0.48])
    Traceback (most recent call last):
    transport.errors.FieldError: matrix[2]: row sums to 0.98, expected 1
    """
    values = checked_numbers(path, row, size)
    for j, p in enumerate(values):
        if not 0.0 <= p <= 1.0:  # NaN fails too
            raise FieldError(f"{path}[{j}]", f"{p:g} is no probability, expected 0 to 1")
    total = math.fsum(values)
    if abs(total - 1.0) > SUM_TOLERANCE:
        raise FieldError(path, f"row sums to {total:.12g}, expected 1")
    return values


def checked_numbers(path: str, row: object, size: int | None = None) -> Row:
    """Return a sequence of numbers as floats; `size` entries, or any number >= 1. Messages start with `path`."""
    if isinstance(row, np.ndarray):
        row = row.tolist()
    if isinstance(row, str) or not isinstance(row, Sequence):
        raise FieldError(path, f"got {row!r}, expected a list of numbers")
    if size is not None and len(row) != size:
        raise FieldError(path, f"has {len(row)} entries, expected {size}")
    if not row:
        raise FieldError(path, "is empty, expected at least one entry")
    for j, value in enumerate(row):
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise FieldError(f"{path}[{j}]", f"got {value!r}, expected a number")
    return tuple(float(value) for value in row)


def checked_matrix(path: str, matrix: object) -> tuple[Row, ...]:
    """Return a row-stochastic matrix as tuples of floats.

    Raises:
        ValueError: not square, or a row that `checked_row` refuses; the message starts with `path` and the row.

    >>> checked_matrix("matrix", [[1.0]])
    ((1.0,),)
    """
    if isinstance(matrix, np.ndarray):
        matrix = matrix.tolist()
    if isinstance(matrix, str) or not isinstance(matrix, Sequence) or not matrix:
        raise FieldError(path, f"got {matrix!r}, expected a square list of rows")
    return tuple(checked_row(f"{path}[{i}]", row, len(matrix)) for i, row in enumerate(matrix))


def closed_classes(matrix: Sequence[Sequence[float]] | NDArray[np.float64]) -> list[list[int]]:
    """Return the closed communicating classes of a chain, each as a sorted list of modes."""
    steps = np.asarray(matrix) > 0.0
    reach = steps | np.eye(len(steps), dtype=bool)
    for _ in range(max(1, len(steps).bit_length())):
        reach = (reach.astype(np.float64) @ reach.astype(np.float64)) > 0.0  # whole numbers: exact in any order
    classes = {tuple(np.flatnonzero(reach[i])) for i in range(len(steps)) if reach[np.flatnonzero(reach[i]), i].all()}
    return sorted([int(i) for i in members] for members in classes)


def stationary_row(matrix: Sequence[Sequence[float]] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the stationary law pi of a chain, pi P = pi, sum(pi) = 1.

    Args:
        matrix: (n, n) row-stochastic.

    Raises:
        ValueError: it is not unique, because the chain has several closed classes.

    >>> stationary_row([[0.5, 0.5], [0.7, 0.3]]).round(6).tolist()
    [0.583333, 0.416667]
    """
    classes = closed_classes(matrix)
    if len(classes) > 1:
        raise ValueError(f"the stationary law is not unique: closed classes of modes {classes}")
    members = classes[0]
    chain = np.asarray(matrix, dtype=np.float64)[np.ix_(members, members)]
    weights = _censored(chain.copy())
    law = np.zeros(len(matrix))
    law[members] = weights / weights.sum()
    return law


def _censored(P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what the stationary law of an irreducible chain is proportional to; P is overwritten.

    State after state is taken out of the chain, without a difference of near numbers, and without BLAS: the same bits everywhere.

    Reference: Grassmann, Taksar and Heyman, Operations Research 33 (1985).
    """
    for n in range(len(P) - 1, 0, -1):
        P[:n, n] /= P[n, :n].sum()
        P[:n, :n] += P[:n, n, None] * P[n, :n]
    weights = np.ones(len(P))
    for n in range(1, len(P)):
        weights[n] = (weights[:n] * P[:n, n]).sum()
    return weights


def mean_holding(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean number of slots that every mode of a chain lasts, (n,): 1/(1 - p_ii)."""
    return np.array([1.0 / (1.0 - p) if p < 1.0 else np.inf for p in np.diag(matrix).tolist()])


def several_of_many(rngs: Iterable[np.random.Generator], runs: int, slots: int, numbers: int) -> NDArray[np.float64]:
    """Return so many uniform numbers of [0, 1) of every slot of many streams, (numbers, slots, runs)."""
    drawn = np.empty((runs, slots, numbers))
    for row, rng in zip(drawn, rngs, strict=True):
        rng.random(out=row)
    return np.ascontiguousarray(np.moveaxis(drawn, (2, 1), (0, 1)))


def chain_ages(first: Row, rows: Sequence[Row], ages: Sequence[int], uniforms: NDArray[np.float64]) -> Ages:
    """Return the ages of many Markov chains, (slots, runs): those that `draw` gives one by one, from the same streams.

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
