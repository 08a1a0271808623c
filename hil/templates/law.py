"""A network law of your own. Its fields are the keys of the table of a law."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Mine:
    """The newest packet is of this slot (age 0) or of the one before (age 1); the age changes with one probability.

    Args:
        change: probability that the age is another one in the next slot.
    """

    change: float = 0.3
    family: ClassVar = "age"
    max_age: ClassVar = 1
    mode_ages: ClassVar = (0, 1)  # with transition_matrix: a ChainLaw, whose loops can be certified

    def transition_matrix(self):
        return np.array([[1 - self.change, self.change], [self.change, 1 - self.change]])

    def start(self, rng):
        return Ages(self.change, rng)


class Ages:
    """The law that runs; all its chance comes from rng."""

    def __init__(self, change, rng):
        self.change, self.rng, self.age = change, rng, int(rng.random() < 0.5)

    def draw(self):  # once a slot: (mode, age)
        now = self.age
        self.age = now ^ int(self.rng.random() < self.change)
        return now, now
