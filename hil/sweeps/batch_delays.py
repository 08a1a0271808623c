"""What a receiver holds in every slot of many runs, and which row an actuator applies: known before a plant moves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hil.experiment import Experiment
from hil.runtime.streams import rng_for
from hil.sweeps.batch_protocols import BatchAges, NewestOfMany
from transport.laws.protocols import AgeLaw, GapLaw, NetworkLaw

Slots = NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Received:
    """What the receiver of one direction holds.

    Args:
        newest: slot of the newest packet that has come, (slots, runs), -1 before the first.
        known: in which runs, (runs,).
    """

    newest: Slots
    known: NDArray[np.bool_]


def law_supports_batch(law: NetworkLaw) -> bool:
    """Return whether what comes over a network law can be computed for many runs at once."""
    return law.family == "age" or isinstance(law, NewestOfMany)


def received(law: NetworkLaw, seeds: Sequence[int], stream: str, experiment: Experiment) -> Received:
    """Return what comes of packets of which one leaves in every slot.

    Args:
        law: of which `law_supports_batch` says so.
        seeds: one run each.
        stream: name of the law's random stream.
        experiment: says how many slots, and when they close.
    """
    e = experiment
    if isinstance(law, NewestOfMany):
        rngs = (rng_for(seed, stream) for seed in seeds)
        period_s = float(e.period)
        found, known = law.newest_of_batch(rngs, len(seeds), e.slots, period_s, e.timing.deadline * period_s)
        return Received(newest=found, known=known)
    age_law = cast(AgeLaw, law)
    ages = drawn_ages(age_law, seeds, stream, e.slots)
    return Received(newest=newest(ages), known=lawful(age_law, ages))


def drawn_ages(law: AgeLaw, seeds: Sequence[int], stream: str, slots: int) -> Slots:
    """Return the ages that an age law draws in the runs of some seeds, (slots, runs)."""
    rngs: Iterable[np.random.Generator] = (rng_for(seed, stream) for seed in seeds)
    if isinstance(law, BatchAges):
        return law.ages_of_batch(rngs, len(seeds), slots)
    drawn = np.empty((slots, len(seeds)), dtype=np.int32)
    for column, rng in zip(drawn.T, rngs):
        draw = law.start(rng).draw
        column[:] = [draw()[1] for _ in range(slots)]
    return drawn


def lawful(law: AgeLaw, ages: Slots) -> NDArray[np.bool_]:
    """Return which runs a law keeps its word in, (runs,): no age beyond its largest, and no gap unless it says so."""
    good: NDArray[np.bool_] = np.asarray(((ages >= 0) & (ages <= law.max_age)).all(axis=0))
    if isinstance(law, GapLaw) and not law.allow_gaps:
        good &= np.asarray((ages[1:] <= ages[:-1] + 1).all(axis=0))
    return good


def newest(ages: Slots) -> Slots:
    """Return the slot of the newest packet that has come, (slots, runs), -1 before the first.

    >>> newest(np.array([[1], [0], [2], [1]], dtype=np.int32)).ravel().tolist()
    [-1, 1, 1, 2]
    """
    sent = np.arange(len(ages), dtype=np.int32)[:, None] - ages
    return np.maximum.accumulate(np.maximum(sent, -1), axis=0)


def starved(usable: NDArray[np.bool_], d_max: int, watchdog_slots: int) -> NDArray[np.bool_]:
    """Return in which runs the watchdog trips, (runs,); see `hil.runtime.nodes.safety.Safety.starved`.

    Args:
        usable: whether the actuator holds a packet that its rows cover, (slots, runs).
        d_max: largest age that they cover; up to that slot nobody waits.
        watchdog_slots: so many slots in a row without one trip it.

    >>> starved(np.array([[0, 1], [1, 1], [0, 0], [0, 1], [0, 0]], dtype=bool), 1, 3).tolist()
    [True, False]
    """
    waits = ~usable
    waits[: d_max + 1] = False
    missing = np.cumsum(waits, axis=0, dtype=np.int32)
    fed = np.maximum.accumulate(np.where(waits, 0, missing), axis=0)
    return np.asarray(((missing - fed) >= watchdog_slots).any(axis=0))


def applied_rows(selection: str, held: Slots, d_max: int) -> Slots:
    """Return which row of the packet held is applied, (slots, runs); see `hil.runtime.nodes.actuator_node.row_index`.

    Args:
        selection: the rule.
        held: slot in which the packet was generated, -1 for none (its row means nothing).
        d_max: largest age that the rows cover.
    """
    k = np.arange(len(held), dtype=np.int32)[:, None]
    d = np.where(held >= 0, k - held, -1)
    if selection == "constant":
        return np.zeros_like(held)
    if selection == "applied":
        return np.maximum(d, 0)
    asked = np.maximum(held - 1 if selection == "previous" else held, 0)
    at = np.take_along_axis(d, asked, axis=0)
    seen = np.where((at >= 0) & (at <= d_max), at, d_max)
    return np.asarray(seen * (d_max + 1) + np.maximum(d, 0) if selection == "both" else seen, dtype=np.int32)
