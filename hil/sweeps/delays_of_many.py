"""What a receiver holds in every slot of many runs, and which row an actuator applies: known before a plant moves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from hil.runtime.streams import rng_for
from hil.sweeps.many import AgesOfMany
from transport.laws.protocols import AgeLaw, GapLaw

Slots = NDArray[np.int32]


def drawn_ages(law: AgeLaw, seeds: Sequence[int], stream: str, slots: int) -> Slots:
    """Return the ages that an age law draws in the runs of some seeds, (slots, runs)."""
    rngs: Iterable[np.random.Generator] = (rng_for(seed, stream) for seed in seeds)
    if isinstance(law, AgesOfMany):
        return law.ages_of_many(rngs, len(seeds), slots)
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
