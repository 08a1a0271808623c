"""What a controller of gains by mode, and one that renders a wall, are asked when their answers are compared."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from design.controllers import LoopModel
from hil.certify.answers_test import SEED, SLOTS, Question, question

if TYPE_CHECKING:
    from design.controllers.scheduled_gain import ScheduledGain
    from design.requests.scheduled import Scheduled

MOST_SLOTS = 1500
"""Slots in which stays are long enough that a gain changes, as far as that goes."""


def scheduled_by(gain: ScheduledGain) -> Scheduled:
    """Return the controller that runs a schedule."""
    from design.requests.scheduled import Scheduled

    def nested(array: np.ndarray) -> tuple:  # type: ignore[type-arg]
        return tuple(nested(part) for part in array) if array.ndim > 1 else tuple(map(float, array))

    return Scheduled(gain=nested(gain.gain), starts_s=nested(gain.starts_s), schedule=gain.schedule)


def mode_question(model: LoopModel, gain: ScheduledGain) -> Question:
    """Return states at random with modes that stay, each once for longer than its gain changes where the test is long enough."""
    rng = np.random.default_rng(SEED)
    modes, longest = gain.modes, float(gain.starts_s.max()) / model.period_s
    stay = int(min(max(1.2 * longest, 20.0), MOST_SLOTS / modes))
    shown: list[int] = []
    for mode in range(modes):
        shown += [mode + 1] * stay
    while len(shown) < SLOTS:
        shown += [int(rng.integers(1, modes + 1))] * int(rng.integers(1, 20))
    plain = question(model, width=model.C.shape[0], slots=len(shown), aims=0.0)
    return replace(plain, samples=np.column_stack([plain.samples[:, :-1], shown]), modes=True)


def wall_question(model: LoopModel, samples: int) -> Question:
    """Return a device that goes in and out of a wall, and along it."""
    rng = np.random.default_rng(SEED)
    steps = rng.uniform(-1.0, 1.0, (SLOTS + samples, 3))
    places = np.array([np.convolve(column, np.ones(8) / 4.0, mode="same") for column in steps.T]).T
    plain = question(model, width=3 * samples, aims=0.0)
    ages = plain.ages[:, 0]
    packets = np.array([np.concatenate([places[max(k - int(ages[k]) - i, 0)] for i in range(samples)]) for k in range(SLOTS)])
    return replace(plain, samples=packets)
