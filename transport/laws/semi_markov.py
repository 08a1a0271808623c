"""Semi-Markov ages: an embedded chain says where to go next, a sojourn law per mode says for how long to stay."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from transport.draws import cumulative, uniforms
from transport.errors import FieldError
from transport.laws import BoundedTail, SemiMarkovLaw, SettlingHazard, Sojourn
from transport.laws.age import AgePath, ChainAge, Initial
from transport.laws.sojourn import Geometric, SojournLaw, hazards
from transport.laws.stochastic_matrix import stationary_row

RESOLUTION = 1e-12
"""Hazards closer than this are the same one: the ratios of survival probabilities are not known any better."""


MOST_STATES = 1000
"""Largest number of states per mode."""


class AugmentedChain(NamedTuple):
    """A semi-Markov chain as a Markov chain on (mode, slots spent in it).

    Attributes:
        matrix: (N, N) row-stochastic.
        modes: mode of every state, (N,).
        slots: slots spent in the mode, this one included, (N,); the last of a mode may stand for all longer ones.
        low, high: entrywise bounds of the matrix, (N, N), from the hazards of all the slots that a state stands for.
        stays: limit of the probability to stay, (N,), in a state that stands for all longer stays; 0 where it is not known.
    """

    matrix: NDArray[np.float64]
    modes: NDArray[np.int64]
    slots: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    stays: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class SemiMarkovAge(ChainAge):
    """Ages driven by a semi-Markov chain.

    A mode i lasts h slots, h drawn from sojourn[i], then mode j follows with probability matrix[i][j]. Modes may share
    an age.

    Args:
        matrix: (n, n) embedded chain: row-stochastic, zero diagonal.
        sojourn: one sojourn law per mode.
        initial: slot 0 is met in a long run ("stationary", in the midst of a sojourn), or begins a sojourn in a mode drawn
            from "uniform" or from one probability per mode.
        ages: age of every mode in slots; the mode's own number by default.
        allow_gaps: accept an age that can grow by more than one per slot.

    Raises:
        ValueError: names the row or the entry.

    Reference: section 8.2.1.
    """

    kind: ClassVar[str] = "semi-markov"
    family: ClassVar[Literal["age"]] = "age"

    matrix: tuple[tuple[float, ...], ...]
    initial: Initial = "stationary"
    ages: tuple[int, ...] | None = None
    allow_gaps: bool = False
    sojourn: tuple[SojournLaw, ...]

    def _check_modes(self) -> None:
        for i, row in enumerate(self.matrix):
            if row[i] != 0.0:
                fault = f"mode {i} is never left" if row[i] == 1.0 else f"mode {i} follows itself"
                raise FieldError(f"matrix[{i}][{i}]", f"{row[i]:g}, {fault}; expected 0, the sojourn law says how long")
        object.__setattr__(self, "sojourn", tuple(self.sojourn))
        if len(self.sojourn) != len(self.matrix):
            raise FieldError("sojourn", f"has {len(self.sojourn)} laws, expected one per mode, {len(self.matrix)}")

    def start(self, rng: np.random.Generator) -> AgePath:
        """Return the process: two uniform numbers per sojourn."""
        return AgePath.of(self._path(rng))

    def _path(self, rng: np.random.Generator) -> Iterator[tuple[int, int]]:
        uniform = uniforms(rng).__next__
        rows = [cumulative(row) for row in self.matrix]
        states = list(enumerate(self.mode_ages))
        samplers = [law.sampler() for law in self.sojourn]
        mode = bisect_right(cumulative(self.initial_law().tolist()), uniform())
        first = remaining_sampler(self.sojourn[mode]) if self.initial == "stationary" else samplers[mode]
        slots = first(uniform())
        while True:
            state = states[mode]
            for _ in range(slots):
                yield state
            mode = bisect_right(rows[mode], uniform())
            slots = samplers[mode](uniform())

    def stationary(self) -> NDArray[np.float64]:
        """Return the share of slots spent in every mode, (n,): nu_i E h_i / sum_j nu_j E h_j, nu P = nu."""
        return shares_and_stays(self)[0]


def shares_and_stays(law: SemiMarkovLaw) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the share of slots spent in every mode, (n,), and the mean number of slots that it lasts, (n,)."""
    stays = np.array([mean_sojourn(sojourn) for sojourn in law.sojourn])
    weights = stationary_row(law.matrix) * stays
    return np.asarray(weights / weights.sum(), dtype=np.float64), stays


def augmented_chain(law: SemiMarkovLaw, *, least: int = 1) -> AugmentedChain:
    """Return the Markov chain on (mode, slots spent in it) that a semi-Markov law is.

    From (i, h) the chain leaves to (j, 1) with probability hazard_i(h) matrix[i][j] and else goes on to (i, h+1). A
    constant hazard needs one state, or `least` where the receiver distinguishes so many lengths of stay. The last state of a
    mode goes on to itself with its own hazard: exact where the sojourn law ends or its hazard is constant from there on,
    otherwise an approximation, and `low` and `high` say between which bounds the tail lies that is cut. A sojourn law that does
    not bound its hazard may do anything beyond the cut.

    Args:
        law: the semi-Markov law, n modes.

        least: lengths of stay that have states of their own, whatever the hazard; the last of them stands for all longer ones.

    Reference: section 8.2.1.

    >>> from transport.laws.sojourn import Geometric, Uniform
    >>> law = SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Geometric(p=0.25), Uniform(low=1, high=2)))
    >>> augmented_chain(law).matrix.tolist()
    [[0.75, 0.25, 0.0], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0]]
    """
    known = [hazards(sojourn, min(sojourn.support, MOST_STATES)) for sojourn in law.sojourn]
    rows = [hazard[: max(len(_distinct(hazard)), least)] for hazard in known]
    first = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    matrix = np.zeros((first[-1], first[-1]))
    low, high = np.zeros_like(matrix), np.zeros_like(matrix)
    stays = np.zeros(len(matrix))
    for i, (row, hazard, sojourn) in enumerate(zip(rows, known, law.sojourn, strict=True)):
        jumps = np.array(law.matrix[i])
        for h, leaving in enumerate(row):
            below, above = (leaving, leaving) if h + 1 < len(row) else _tail(hazard[h:], sojourn, len(hazard))
            state, following = first[i] + h, min(first[i] + h + 1, first[i + 1] - 1)
            for chain, out, stay in ((matrix, leaving, leaving), (low, below, above), (high, above, below)):
                chain[state, first[:-1]] = out * jumps
                chain[state, following] += 1.0 - stay
        if hazard[-1] < 1.0:  # no slot is the last one for sure
            stays[first[i + 1] - 1] = longest_stay(sojourn)
    modes = np.repeat(np.arange(len(rows)), [len(row) for row in rows])
    slots = np.concatenate([np.arange(1, len(row) + 1) for row in rows])
    return AugmentedChain(matrix, modes, slots, low, high, stays)


def _tail(known: NDArray[np.float64], sojourn: Sojourn, cut: int) -> tuple[float, float]:
    """Bounds of the hazard in the state that stands for all that is left: of what is known of it, and beyond the cut."""
    least, most = hazard_bounds(sojourn, cut)
    ended = known[-1] == 1.0  # no sojourn is longer, so that nothing is beyond
    least, most = (1.0, 1.0) if ended else (least, most)
    least, most = min(least, float(known.min())), max(most, float(known.max()))
    return (known[0], known[0]) if most - least <= RESOLUTION else (least, most)


def _distinct(hazard: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cut the tail in which the hazard no longer changes."""
    changes = np.flatnonzero(np.abs(np.diff(hazard)) > RESOLUTION)
    return hazard[: 1 if not len(changes) else changes[-1] + 2]


def hazard_bounds(law: Sojourn, slots: int) -> tuple[float, float]:
    """Return the infimum and the supremum of the hazard at all n > slots: (0, 1) for a law that does not say.

    >>> hazard_bounds(Geometric(p=0.25), 7)
    (0.25, 0.25)
    """
    return law.hazard_beyond(slots) if isinstance(law, BoundedTail) else (0.0, 1.0)


def longest_stay(law: Sojourn) -> float:
    """Return the limit of the probability to stay one slot more, of a stay that has lasted long; 0 for a law that does not say.

    >>> from transport.laws.sojourn import DiscreteWeibull, Table
    >>> longest_stay(DiscreteWeibull(q=0.6, beta=0.8)), longest_stay(Table(probabilities=(0.5, 0.5)))
    (1.0, 0.0)
    """
    return 1.0 - law.hazard_limit() if isinstance(law, SettlingHazard) else 0.0


def mean_sojourn(law: Sojourn) -> float:
    """Return E h = sum_{n>=0} S(n), slots.

    >>> mean_sojourn(Geometric(p=0.25))
    4.0
    """
    return float(law.survival(np.arange(law.support + 1)).sum()) if not isinstance(law, Geometric) else 1.0 / law.p


def remaining_sampler(law: Sojourn) -> Callable[[float], int]:
    """Return the sampler of the slots that are left, this one included, when a mode is met at any slot of a long run.

    Pr(remaining = n) = S(n-1)/E h: long sojourns are met more often (renewal theory, equilibrium distribution).
    """
    weights = law.survival(np.arange(law.support))
    reached = (np.cumsum(weights) / weights.sum()).tolist()
    reached[-1] = 1.0
    return lambda u: bisect_right(reached, u) + 1
