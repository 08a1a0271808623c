"""Sojourn laws: for how many slots a mode of a semi-Markov chain lasts, Pr(h = 1), Pr(h = 2), ...

Every law is given by its survival function S(n) = Pr(h > n), S(0) = 1. All else follows from it: the hazard
Pr(h = n | h >= n) = 1 - S(n)/S(n-1), the mean sum_{n>=0} S(n), the draw h = smallest n with S(n) <= 1 - u.

Logarithms and powers are the same on every machine. ``libm`` differs from one processor to the next in the last bit. Where that
bit could decide, it is asked of `decimal`, which Python computes with whole numbers; where it cannot, a double is enough, and
quicker.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from decimal import Context, Decimal
from functools import lru_cache
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from transport.errors import FieldError
from transport.laws import Sojourn
from transport.laws.stochastic_matrix import checked_row

LONGEST = 100_000
TAIL = 1e-12

CLOSE: Final = 1e-12
"""Relative distance below which a number in doubles may be on either side of another: some thousand units in the last place."""

_DIGITS: Final = Context(prec=40, Emin=-(10**6), Emax=10**6)
_EXACT: Final = Context(prec=1200, Emin=-(10**6), Emax=10**6)  # a double has at most 1,074 decimals

_BITS: Final = 43
"""Of a power that are kept. How far one in doubles may be off decides which of them have to be computed in decimals."""


def ln(x: float) -> Decimal:
    """Return ln x to 40 digits, for x > 0."""
    return _DIGITS.ln(Decimal(x))


def ln_complement(u: float) -> Decimal:
    """Return ln(1 - u) to 40 digits, for 0 <= u < 1."""
    return _DIGITS.ln(_EXACT.subtract(Decimal(1), Decimal(u)))


def root(value: Decimal, power: float) -> Decimal:
    """Return value^(1/power) to 40 digits, for a value of at least 0."""
    return _DIGITS.exp(_DIGITS.divide(_DIGITS.ln(value), Decimal(power))) if value else value


def complement_of_power(q: float, order: float, other: float, beta: float) -> float:
    """Return 1 - q^(order^beta - other^beta), for order > other >= 0."""
    first, second = (_DIGITS.exp(_DIGITS.multiply(Decimal(beta), ln(n))) if n else Decimal(0) for n in (order, other))
    return float(_DIGITS.subtract(Decimal(1), _DIGITS.exp(_DIGITS.multiply(ln(q), _DIGITS.subtract(first, second)))))


def whole_powers(base: float, exponents: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return base^n for whole n >= 0, same shape, by squaring."""
    left = np.asarray(exponents, dtype=np.int64).copy()
    out, square = np.ones(left.shape), base
    while left.any():
        out = np.where(left & 1, out * square, out)
        left >>= 1
        square *= square
    return out


def powers(q: float, beta: float, slots: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return q^(n^beta) for whole n >= 0, rounded to 43 bits, same shape.

    Args:
        q: between 0 and 1.
        beta: above 0.
        slots: n.
    """
    n = np.asarray(slots, dtype=np.int64)
    if beta == 1.0:
        return whole_powers(q, n)
    order = n.astype(np.float64) ** beta
    mantissa, exponent = np.frexp(q**order)
    scaled = np.ldexp(mantissa, _BITS)
    off = np.ldexp(4.0 + 4.0 * order * abs(float(ln(q))), _BITS - 53)  # units in the last place, as units of what is kept
    unsure = np.abs(scaled - np.floor(scaled) - 0.5) <= off
    out = np.ldexp(np.rint(scaled), exponent - _BITS)
    for at in zip(*np.nonzero(unsure)):
        out[at] = _rounded(q, beta, int(n[at]))
    return np.asarray(out, dtype=np.float64)


@lru_cache(maxsize=100_000)
def _rounded(q: float, beta: float, n: int) -> float:
    exact = _DIGITS.exp(_DIGITS.multiply(ln(q), _DIGITS.exp(_DIGITS.multiply(Decimal(beta), ln(float(n)))))) if n else Decimal(1)
    _, exponent = np.frexp(float(exact))
    whole = int(_DIGITS.multiply(exact, _DIGITS.power(Decimal(2), _BITS - int(exponent))).to_integral_value())
    return float(np.ldexp(float(whole), int(exponent) - _BITS))


class Geometric(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="law", tag="geometric"):
    """Pr(h = n) = p (1-p)^(n-1): the memoryless law of a Markov chain.

    Args:
        p: probability of leaving in a slot, 0 < p <= 1.

    >>> Geometric(p=0.25).survival(np.arange(3)).tolist()
    [1.0, 0.75, 0.5625]
    """

    p: float

    def __post_init__(self) -> None:
        if not 0.0 < self.p <= 1.0:
            raise FieldError("p", f"got {self.p:g}, expected 0 < p <= 1")
        _refuse_longest("p", self.support)

    @property
    def support(self) -> int:
        """Sojourn time beyond which the probability is below 1e-12."""
        return 1 if self.p == 1.0 else math.ceil(ln(TAIL) / ln_complement(self.p))

    def survival(self, slots: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return S(n) = (1-p)^n."""
        return whole_powers(1.0 - self.p, slots)

    def hazard_beyond(self, slots: int) -> tuple[float, float]:
        """Return the infimum and the supremum of the hazard: both are p."""
        return self.p, self.p

    def sampler(self) -> Callable[[float], int]:
        """Return the inverse of the distribution function."""
        if self.p == 1.0:
            return lambda u: 1
        scale, p = 1.0 / math.log1p(-self.p), self.p

        def sojourn(u: float) -> int:
            slots = math.log1p(-u) * scale
            if abs(slots - round(slots)) <= CLOSE * (1.0 + slots):  # the last bit of a logarithm shall decide nothing
                return int(ln_complement(u) / ln_complement(p)) + 1
            return int(slots) + 1

        return sojourn


class DiscreteWeibull(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="law", tag="discrete-weibull"):
    """S(n) = q^(n^beta), discrete Weibull law of type I (Nakagawa and Osaki, 1975).

    The hazard falls with time for beta < 1 (long bursts get longer) and rises for beta > 1; beta = 1 is geometric, p =
    1 - q.

    Args:
        q: probability of staying at least two slots, 0 < q < 1.
        beta: shape, > 0.
    """

    q: float
    beta: float

    def __post_init__(self) -> None:
        if not 0.0 < self.q < 1.0:
            raise FieldError("q", f"got {self.q:g}, expected 0 < q < 1")
        if not 0.0 < self.beta < math.inf:
            raise FieldError("beta", f"got {self.beta:g}, expected a positive number")
        _refuse_longest("beta", self.support)

    @property
    def support(self) -> int:
        """Sojourn time beyond which the probability is below 1e-12."""
        slots = _root(math.log(TAIL) / math.log(self.q), self.beta)
        if abs(slots - round(min(slots, 2.0 * LONGEST))) <= 1e-6:
            return math.ceil(root(ln(TAIL) / ln(self.q), self.beta))
        return math.ceil(slots) if slots <= LONGEST else LONGEST + 1

    def survival(self, slots: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return S(n) = q^(n^beta)."""
        return powers(self.q, self.beta, slots)

    def hazard_beyond(self, slots: int) -> tuple[float, float]:
        """Return the bounds over n > slots of 1 - q^(n^beta - (n-1)^beta), which tends to 0 for beta < 1, to 1 for beta > 1."""
        if self.beta == 1.0:
            return 1.0 - self.q, 1.0 - self.q
        following = complement_of_power(self.q, slots + 1.0, float(slots), self.beta)
        return (0.0, following) if self.beta < 1.0 else (following, 1.0)

    def hazard_limit(self) -> float:
        """Return the limit of the hazard: n^beta - (n-1)^beta tends to 0 for beta < 1, to infinity for beta > 1."""
        return 1.0 - self.q if self.beta == 1.0 else float(self.beta > 1.0)

    def sampler(self) -> Callable[[float], int]:
        """Return the inverse of the distribution function."""
        scale, power, log_q, beta = 1.0 / math.log(self.q), 1.0 / self.beta, ln(self.q), self.beta

        def sojourn(u: float) -> int:
            slots = (math.log1p(-u) * scale) ** power
            if abs(slots - round(slots)) <= CLOSE * (1.0 + power) * (1.0 + slots):
                return max(1, math.ceil(root(ln_complement(u) / log_q, beta)))
            return int(max(1, math.ceil(slots)))

        return sojourn


class Uniform(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="law", tag="uniform"):
    """Every length from `low` to `high` slots is equally likely.

    Args:
        low: slots, >= 1.
        high: slots, >= low.
    """

    low: int
    high: int

    def __post_init__(self) -> None:
        if self.low < 1:
            raise FieldError("low", f"got {self.low}, expected at least 1 slot")
        if self.high < self.low:
            raise FieldError("high", f"got {self.high}, expected at least low, {self.low}")
        _refuse_longest("high", self.high)

    @property
    def support(self) -> int:
        """Largest sojourn time."""
        return self.high

    def survival(self, slots: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return S(n) = (high - n)/(high - low + 1), within 0 and 1."""
        return np.clip((self.high - slots) / (self.high - self.low + 1), 0.0, 1.0)

    def hazard_beyond(self, slots: int) -> tuple[float, float]:
        """Return the bounds of the hazard at the slots that are left; (1, 1) where no sojourn lasts longer."""
        return bounds_until_the_end(self, slots)

    def sampler(self) -> Callable[[float], int]:
        """Return the inverse of the distribution function."""
        low, count = self.low, self.high - self.low + 1
        return lambda u: low + int(u * count)


class Table(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="law", tag="table"):
    """Pr(h = n) = probabilities[n - 1].

    Args:
        probabilities: of 1, 2, ... slots, sum 1.
    """

    probabilities: tuple[float, ...]

    def __post_init__(self) -> None:
        checked_row("probabilities", self.probabilities)
        _refuse_longest("probabilities", self.support)

    @property
    def support(self) -> int:
        """Largest sojourn time of positive probability."""
        return 1 + max(n for n, p in enumerate(self.probabilities) if p > 0.0)

    def survival(self, slots: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return S(n) = sum of the probabilities of more than n slots."""
        kept = np.array(self.probabilities[: self.support])
        tails = np.append(np.cumsum(kept[::-1])[::-1] / kept.sum(), 0.0)
        return np.asarray(tails[np.minimum(slots, len(kept))], dtype=np.float64)

    def hazard_beyond(self, slots: int) -> tuple[float, float]:
        """Return the bounds of the hazard at the slots that are left; (1, 1) where no sojourn lasts longer."""
        return bounds_until_the_end(self, slots)

    def sampler(self) -> Callable[[float], int]:
        """Return the inverse of the distribution function, by bisection."""
        reached = (1.0 - self.survival(np.arange(1, self.support + 1))).tolist()
        reached[-1] = 1.0
        return lambda u: bisect_right(reached, u) + 1


SojournLaw = Geometric | DiscreteWeibull | Uniform | Table


def _root(value: float, power: float) -> float:
    try:
        return float(value ** (1.0 / power))
    except OverflowError:
        return math.inf


def _refuse_longest(field: str, slots: int) -> None:
    if slots > LONGEST:
        raise FieldError(field, f"sojourns beyond {LONGEST} slots are likelier than {TAIL:g}, expected shorter ones")


def hazards(law: Sojourn, longest: int | None = None) -> NDArray[np.float64]:
    """Return Pr(h = n | h >= n) = 1 - S(n)/S(n-1), n = 1 .. longest (default: support), (longest,); 1 where S(n-1) is
    0.

    >>> hazards(Geometric(p=0.25), 3).tolist()
    [0.25, 0.25, 0.25]
    """
    survival = law.survival(np.arange((law.support if longest is None else longest) + 1))
    before, after = survival[:-1], survival[1:]
    return 1.0 - np.divide(after, before, out=np.zeros_like(after), where=before > 0.0)


def bounds_until_the_end(law: Sojourn, slots: int) -> tuple[float, float]:
    """Return the smallest and the largest hazard at n > slots of a law that ends with its support.

    >>> bounds_until_the_end(Uniform(low=1, high=4), 2)
    (0.5, 1.0)
    """
    left = hazards(law)[slots:]
    return (float(left.min()), float(left.max())) if len(left) else (1.0, 1.0)
