"""Age laws with at most one step of memory: constant, iid and Markov (the thesis's model, (7.34)), with checks of their fields.

A field may hold ages in slots, ages of modes without gaps, and the law of slot 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import ClassVar, Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from transport.draws import ChainDraws, cumulative
from transport.errors import FieldError
from transport.laws.stochastic_matrix import (
    Ages,
    Row,
    chain_ages,
    checked_matrix,
    checked_row,
    mean_holding,
    several_of_many,
    stationary_row,
)

Initial = Literal["stationary", "uniform"] | tuple[float, ...]
LARGEST_AGE = 100_000
ROUNDING = 1e-12
"""A probability up to this of what no link does is rounding of the row that was computed: it becomes 0 in the law itself."""


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


def without_gaps(path: str, row: Row, ages: Sequence[int], age: int) -> Row:
    """Return a probability row in which no age grows by more than one per slot; an entry of rounding that lets it grow is 0.

    A receiver that keeps the newest packet ages by exactly one per slot when nothing newer comes, so a larger `ages[j]` with
    `row[j] > 0` describes no packet link.

    Args:
        path: field path that starts every message.
        row: probabilities of the next modes.
        ages: of every mode.
        age: of the mode, or the least one, before.

    Raises:
        ValueError: names the offending entry.

    >>> without_gaps("row", (0.7, 0.3, 1e-16), [0, 1, 2], 0)
    (0.7, 0.3, 0.0)
    >>> without_gaps("row", (0.6, 0.3, 0.1), [0, 1, 2], 0)
    Traceback (most recent call last):
    transport.errors.FieldError: row[2]: 0.1 lets the age grow from 0 to 2, at most 1 per slot is possible (allow_gaps permits it)
    """
    for j, p in enumerate(row):
        if p > ROUNDING and ages[j] > age + 1:
            said = f"{p:g} lets the age grow from {age} to {ages[j]}, at most 1 per slot is possible (allow_gaps permits it)"
            raise FieldError(f"{path}[{j}]", said)
    return tuple(0.0 if ages[j] > age + 1 else p for j, p in enumerate(row))


def checked_initial(initial: object, modes: int) -> Initial:
    """Return the initial law: "stationary", "uniform", or one probability per mode."""
    if initial == "stationary":
        return "stationary"
    if initial == "uniform":
        return "uniform"
    if isinstance(initial, str):
        raise FieldError("initial", f'got {initial!r}, expected "stationary", "uniform" or a list of probabilities')
    return checked_row("initial", initial, modes)


class AgePath(Struct, frozen=True):
    """A running age law as an endless iterator of (mode, age); `draw` is the iterator's own `__next__`, hence fast."""

    draw: Callable[[], tuple[int, int]]

    @classmethod
    def of(cls, states: Iterator[tuple[int, int]]) -> AgePath:
        """Return the path over these states. The first is drawn now: slot 0 does not pay for what a law does once."""
        return cls(chain((next(states),), states).__next__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantAge:
    """Every packet is `age` slots old when it is used.

    Args:
        age: slots.

    Raises:
        ValueError: `age` is no whole number of slots.

    >>> ConstantAge(age=2).start(np.random.default_rng(0)).draw()
    (0, 2)
    """

    kind: ClassVar[str] = "constant"
    family: ClassVar[Literal["age"]] = "age"
    allow_gaps: ClassVar[bool] = False

    age: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "age", checked_age("age", self.age))

    @property
    def max_age(self) -> int:
        """The age itself."""
        return self.age

    @property
    def mode_ages(self) -> tuple[int, ...]:
        """Age of every mode, in slots."""
        return (self.age,)

    def start(self, rng: np.random.Generator) -> AgePath:
        """Return the process; it draws nothing from `rng`."""
        state = (0, self.age)
        return AgePath(lambda: state)

    def ages_of_batch(self, rngs: Iterable[np.random.Generator], runs: int, slots: int) -> Ages:
        """Return the ages that many processes draw, (slots, runs)."""
        return np.full((slots, runs), self.age, dtype=np.int32)

    def transition_matrix(self) -> NDArray[np.float64]:
        """Return the one-mode chain, (1, 1)."""
        return np.ones((1, 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class IidAge:
    """Independent ages: Pr(age_k = i) = probabilities[i].

    With more than two adjacent ages in its support this describes no link that keeps the newest packet, see
    `without_gaps`.

    Args:
        probabilities: of ages 0, 1, ..., sum 1.
        allow_gaps: accept an age that can grow by more than one per slot.

    Raises:
        ValueError: names the entry.

    Reference: the iid case of section 7.2.
    """

    kind: ClassVar[str] = "iid"
    family: ClassVar[Literal["age"]] = "age"

    probabilities: tuple[float, ...]
    allow_gaps: bool = False

    def __post_init__(self) -> None:
        row = checked_row("probabilities", self.probabilities)
        if not self.allow_gaps:
            row = without_gaps("probabilities", row, range(len(row)), next(i for i, p in enumerate(row) if p > 0.0))
        checked_age("probabilities", len(row) - 1)
        object.__setattr__(self, "probabilities", row)

    @property
    def max_age(self) -> int:
        """Largest age of positive probability, in slots."""
        return max(i for i, p in enumerate(self.probabilities) if p > 0.0)

    @property
    def mode_ages(self) -> tuple[int, ...]:
        """Age of every mode, in slots: the mode itself."""
        return tuple(range(len(self.probabilities)))

    def start(self, rng: np.random.Generator) -> ChainDraws:
        """Return the process: one uniform number per slot."""
        row = cumulative(self.probabilities)
        return ChainDraws(row, [row] * len(row), self.mode_ages, rng)

    def ages_of_batch(self, rngs: Iterable[np.random.Generator], runs: int, slots: int) -> Ages:
        """Return the ages that many processes draw, (slots, runs), each from its own stream."""
        rows = [self.probabilities] * len(self.probabilities)
        return chain_ages(self.probabilities, rows, self.mode_ages, several_of_many(rngs, runs, slots, 1)[0])

    def transition_matrix(self) -> NDArray[np.float64]:
        """Return the chain with equal rows, (n, n)."""
        return np.tile(self.probabilities, (len(self.probabilities), 1))

    def stationary(self) -> NDArray[np.float64]:
        """Return the stationary law over modes, (n,)."""
        return np.array(self.probabilities)

    def mean_bursts(self) -> NDArray[np.float64]:
        """Return the mean number of slots that a mode lasts, (n,): 1/(1 - p_i)."""
        return mean_holding(self.transition_matrix())


class ChainAge:
    """What Markov and semi-Markov age laws share: a chain over modes, each with an age."""

    __slots__ = ()
    matrix: tuple[tuple[float, ...], ...]
    initial: Initial
    ages: tuple[int, ...] | None
    allow_gaps: bool

    def __post_init__(self) -> None:
        matrix = checked_matrix("matrix", self.matrix)
        object.__setattr__(self, "matrix", matrix)
        self._check_modes()
        object.__setattr__(self, "ages", checked_ages(self.ages, len(matrix)))
        object.__setattr__(self, "initial", checked_initial(self.initial, len(matrix)))
        if not self.allow_gaps:
            ages = self.mode_ages
            matrix = tuple(without_gaps(f"matrix[{i}]", row, ages, ages[i]) for i, row in enumerate(matrix))
            object.__setattr__(self, "matrix", matrix)
        if self.initial == "stationary":
            try:
                stationary_row(matrix)
            except ValueError as fault:
                raise FieldError("initial", f'{fault}; give "uniform" or a list') from None

    def _check_modes(self) -> None:
        """Refuse a mode that the law cannot have."""

    @property
    def max_age(self) -> int:
        """Largest age of any mode, in slots."""
        return max(self.mode_ages)

    @property
    def mode_ages(self) -> tuple[int, ...]:
        """Age of every mode, in slots."""
        return tuple(range(len(self.matrix))) if self.ages is None else self.ages

    def stationary(self) -> NDArray[np.float64]:
        """Return the share of slots spent in every mode, (n,)."""
        return stationary_row(self.matrix)

    def initial_law(self) -> NDArray[np.float64]:
        """Return the law of the mode in slot 0, (n,)."""
        if self.initial == "stationary":
            return self.stationary()
        if self.initial == "uniform":
            return np.full(len(self.matrix), 1.0 / len(self.matrix))
        return np.array(self.initial, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkovAge(ChainAge):
    """Ages driven by a Markov chain: Pr(mode_{k+1} = j | mode_k = i) = matrix[i][j].

    Args:
        matrix: (n, n) row-stochastic.
        initial: law of the mode in slot 0: "stationary", "uniform", or one probability per mode.
        ages: age of every mode in slots; the mode's own number by default.
        allow_gaps: accept an age that can grow by more than one per slot.
        allow_absorbing: accept a mode that is never left.

    Raises:
        ValueError: names the row or the entry.

    Reference: section 7.2, (7.34).

    >>> MarkovAge(matrix=((0.5, 0.5), (0.7, 0.3))).stationary().round(4).tolist()
    [0.5833, 0.4167]
    """

    kind: ClassVar[str] = "markov"
    family: ClassVar[Literal["age"]] = "age"

    matrix: tuple[tuple[float, ...], ...]
    initial: Initial = "stationary"
    ages: tuple[int, ...] | None = None
    allow_gaps: bool = False
    allow_absorbing: bool = False

    def _check_modes(self) -> None:
        for i, row in enumerate(self.matrix):
            if row[i] == 1.0 and len(self.matrix) > 1 and not self.allow_absorbing:
                raise FieldError(f"matrix[{i}]", f"mode {i} is never left (allow_absorbing permits it)")

    def start(self, rng: np.random.Generator) -> ChainDraws:
        """Return the process: one uniform number per slot."""
        first = cumulative(self.initial_law().tolist())
        return ChainDraws(first, [cumulative(row) for row in self.matrix], self.mode_ages, rng)

    def ages_of_batch(self, rngs: Iterable[np.random.Generator], runs: int, slots: int) -> Ages:
        """Return the ages that many processes draw, (slots, runs), each from its own stream."""
        first = tuple(self.initial_law().tolist())
        return chain_ages(first, self.matrix, self.mode_ages, several_of_many(rngs, runs, slots, 1)[0])

    def transition_matrix(self) -> NDArray[np.float64]:
        """Return the chain, (n, n)."""
        return np.array(self.matrix)
