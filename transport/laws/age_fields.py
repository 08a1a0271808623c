"""What the fields of an age law may hold: ages in slots, ages of modes without gaps, and the law of slot 0."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from transport.errors import FieldError
from transport.laws.stochastic_matrix import Row, checked_row

Initial = Literal["stationary", "uniform"] | tuple[float, ...]
LARGEST_AGE = 100_000


def checked_age(path: str, age: object) -> int:
    """Return an age in slots, 0 to `LARGEST_AGE` (it bounds the memory of the impairment).

    >>> checked_age("age", -1)
    Traceback (most recent call last):
    transport.errors.FieldError: age: got -1, expected a whole number of slots, 0 to 100000
    """
    if isinstance(age, (bool, np.bool_)) or not isinstance(age, (int, np.integer)) or not 0 <= age <= LARGEST_AGE:
        raise FieldError(path, f"got {age!r}, expected a whole number of slots, 0 to {LARGEST_AGE}")
    return int(age)


def checked_ages(ages: object, modes: int) -> tuple[int, ...] | None:
    """Return the mapping mode -> age, or None for the identity; `modes` entries."""
    if ages is None:
        return None
    if isinstance(ages, str) or not isinstance(ages, Sequence):
        raise FieldError("ages", f"got {ages!r}, expected one age per mode")
    if len(ages) != modes:
        raise FieldError("ages", f"has {len(ages)} entries, expected one age per mode, {modes}")
    return tuple(checked_age(f"ages[{i}]", age) for i, age in enumerate(ages))


def refuse_gaps(matrix: Sequence[Row], ages: Sequence[int]) -> None:
    """Refuse a chain in which an age can grow by more than one per slot.

    A receiver that keeps the newest packet ages by exactly one per slot when nothing newer comes, so `age[j] > age[i]
    + 1` with P_ij > 0 describes no packet link.

    Raises:
        ValueError: names the offending entry.

    >>> refuse_gaps([(0.6, 0.3, 0.1), (1, 0, 0), (1, 0, 0)], [0, 1, 2])  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    transport.errors.FieldError: matrix[0][2]: 0.1 lets the age grow from 0 to 2, at most 1 per slot is possible ...
    """
    for i, row in enumerate(matrix):
        for j, p in enumerate(row):
            if p > 0.0 and ages[j] > ages[i] + 1:
                raise FieldError(
                    f"matrix[{i}][{j}]",
                    f"{p:g} lets the age grow from {ages[i]} to {ages[j]}, "
                    "at most 1 per slot is possible (allow_gaps permits it)",
                )


def checked_initial(initial: object, modes: int) -> Initial:
    """Return the initial law: "stationary", "uniform", or one probability per mode."""
    if initial == "stationary":
        return "stationary"
    if initial == "uniform":
        return "uniform"
    if isinstance(initial, str):
        raise FieldError("initial", f'got {initial!r}, expected "stationary", "uniform" or a list of probabilities')
    return checked_row("initial", initial, modes)
