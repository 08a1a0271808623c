"""Wald's sequential test of a probability: it looks after every run, and stops as soon as its two errors allow.

After n runs with s successes the logarithm of the likelihood ratio of p_1 against p_0 < p_1 is

    L = s log(p_1 / p_0) + (n - s) log((1 - p_1) / (1 - p_0)).

It is a martingale's logarithm under p_0, and its negative under p_1, so that by Ville's inequality the bounds
L >= log(1 / alpha) and L <= log(beta) are crossed wrongly with at most alpha and beta, whenever one looks. For p < p_0
and p > p_1 the errors are smaller still. (Wald's own bounds, log((1 - beta) / alpha), hold only nearly.)

Reference: A. Wald, Sequential Analysis, 1947, chapter 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from design.errors import FieldError

Decision = Literal["at least p1", "at most p0"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SequentialTest:
    """A sequential test of p <= p_0 against p >= p_1.

    Args:
        p0: the probability that is too low.
        p1: the probability that is high enough, above ``p0``.
        alpha: largest probability to decide "at least p1" when p <= p_0.
        beta: largest probability to decide "at most p0" when p >= p_1.

    Raises:
        ValueError: unless 0 < p0 < p1 < 1 and both errors lie between 0 and 1; the message starts with the field.

    >>> test = SequentialTest(p0=0.95, p1=0.975, alpha=1e-3, beta=1e-3)
    >>> test.decide(265, 265), test.decide(266, 266), test.decide(266, 300)
    (None, 'at least p1', 'at most p0')
    """

    p0: float
    p1: float
    alpha: float
    beta: float

    def __post_init__(self) -> None:
        if not 0.0 < self.p0 < self.p1 < 1.0:
            raise FieldError("p0", f"{self.p0:g}, p1: {self.p1:g}; expected 0 < p0 < p1 < 1")
        for name, value in (("alpha", self.alpha), ("beta", self.beta)):
            if not 0.0 < value < 1.0:
                raise FieldError(name, f"{value:g}; expected a number between 0 and 1")

    def decide(self, successes: int, runs: int) -> Decision | None:
        """Return what is decided after some runs, None if more are needed."""
        ratio = successes * math.log(self.p1 / self.p0) + (runs - successes) * math.log((1.0 - self.p1) / (1.0 - self.p0))
        if ratio >= -math.log(self.alpha):
            return "at least p1"
        return "at most p0" if ratio <= math.log(self.beta) else None
