"""How a verdict comes about: computed numbers, each with a rule, and nothing else.

A `Row` is one number or claim of a chapter. It carries *checks*, which say what would have to be true for the print to hold,
and, for a claim that we say is wrong, the *witness*: checks that refute it.

    all checks hold                      ->  reproduced
    else, all checks of the witness hold ->  claim false
    else, a check fails                  ->  not reproduced
    else                                 ->  undecided

A statistic has an interval besides its value, and its check holds or fails only if the whole interval does. Where the interval
lies across the limit the check is undecided: more runs would be needed. No row is given a verdict. A check is one computed
number (or word) and one rule, so that a wrong number turns it:

    near("norm", h2_norm(loop), 0.1225, relative=0.01)          a printed number and a tolerance
    standard_errors("mean", mean, 9.91, sd=2.2, runs=10_000)    a printed Monte-Carlo mean against ours
    rank("share of runs below 0.0356", sums, 0.0356)            a printed single run among emulated ones, whatever their law
    below("radius", radius, 1.0)    above(...)    within(...)   one-sided claims, intervals
    says("verdict", certificate.verdict, "refused")             a word that a certificate says, never one that we write down
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np
import numpy.typing as npt

Verdict = Literal["reproduced", "not reproduced", "claim false", "undecided"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
Value = float | str

ERRORS = 4.0
"""Standard errors that a Monte-Carlo mean may be off: two-sided error rate 6e-5 for a normal mean."""

TAIL = 0.005
"""Share of emulated runs that must lie on either side of a printed run: two-sided error rate 1 %, whatever the law."""

LEVEL = 0.99
"""Of the interval of a share of runs (Clopper and Pearson)."""


class Rule(Protocol):
    """What a computed value must fulfil."""

    def holds(self, value: Value) -> bool:
        """Whether the value fulfils it; NaN never does."""
        ...


@dataclass(frozen=True, slots=True)
class Near:
    """|value - printed| <= max(relative |printed|, absolute)."""

    printed: float
    relative: float = 0.0
    absolute: float = 0.0
    why: str = ""

    def holds(self, value: Value) -> bool:
        """See `Rule`."""
        return abs(float(value) - self.printed) <= max(self.relative * abs(self.printed), self.absolute)

    def __str__(self) -> str:
        size = max(self.relative * abs(self.printed), self.absolute)
        return f"within {size:.3g} of {self.printed:g}" + (f" ({self.why})" if self.why else "")


@dataclass(frozen=True, slots=True)
class Within:
    """low < value < high."""

    low: float = -math.inf
    high: float = math.inf

    def holds(self, value: Value) -> bool:
        """See `Rule`."""
        return self.low < float(value) < self.high

    def __str__(self) -> str:
        if math.isinf(self.low):
            return f"< {self.high:g}"
        return f"> {self.low:g}" if math.isinf(self.high) else f"between {self.low:g} and {self.high:g}"


@dataclass(frozen=True, slots=True)
class Is:
    """The value is this word."""

    word: str

    def holds(self, value: Value) -> bool:
        """See `Rule`."""
        return value == self.word

    def __str__(self) -> str:
        return f"is {self.word!r}"


@dataclass(frozen=True, slots=True)
class Check:
    """One computed value and the rule that it is judged by.

    Args:
        what: what the value is, with its unit.
        value: what came out.
        rule: see `Rule`.
        interval: that of a statistic's value; empty for a value that is computed and not sampled.
    """

    what: str
    value: Value
    rule: Rule
    interval: tuple[float, float] | tuple[()] = ()

    @property
    def holds(self) -> bool:
        """Whether the value, and all of its interval, fulfils the rule."""
        return all(self._said)

    @property
    def undecided(self) -> bool:
        """Whether only a part of the interval fulfils the rule."""
        return any(self._said) and not all(self._said)

    @property
    def _said(self) -> list[bool]:
        return [self.rule.holds(value) for value in (self.value, *self.interval)]

    def __str__(self) -> str:
        text = f"{self.what} {self.value if isinstance(self.value, str) else format(self.value, '.4g')}"
        return text + (f" [{self.interval[0]:.2g}, {self.interval[1]:.2g}]" if self.interval else "")

    def to_json(self) -> dict[str, object]:
        """What, value (None if it is not finite), rule and whether it holds; of a statistic the interval too."""
        value = self.value if isinstance(self.value, str) or math.isfinite(self.value) else None
        found: dict[str, object] = {"what": self.what, "value": value, "rule": str(self.rule), "holds": self.holds}
        return found | ({"interval": list(self.interval), "undecided": self.undecided} if self.interval else {})


def near(what: str, value: float, printed: float, *, relative: float = 0.0, absolute: float = 0.0) -> Check:
    """The value lies within a tolerance of the printed one; ``absolute=0.5e-4`` is four printed decimals."""
    return Check(what, float(value), Near(printed, relative, absolute))


def below(what: str, value: float, limit: float) -> Check:
    """The value is less than a limit."""
    return Check(what, float(value), Within(high=limit))


def above(what: str, value: float, limit: float) -> Check:
    """The value is greater than a limit."""
    return Check(what, float(value), Within(low=limit))


def within(what: str, value: float, low: float, high: float) -> Check:
    """The value lies between two limits."""
    return Check(what, float(value), Within(low, high))


def says(what: str, value: str, word: str) -> Check:
    """A computation (a certificate, a search) says this word."""
    return Check(what, value, Is(word))


def standard_errors(
    what: str, mean: float, printed: float, *, sd: float, runs: int, printed_runs: int = 0, errors: float = ERRORS
) -> Check:
    """A Monte-Carlo mean lies within ``errors`` standard errors of the printed number.

    The standard error is sd sqrt(1/runs + 1/printed_runs), the second term only where the printed number is a mean of runs too.
    """
    error = sd * math.sqrt(1.0 / runs + (1.0 / printed_runs if printed_runs else 0.0))
    why = f"{errors:g} standard errors, {runs} runs" + (f" and {printed_runs} printed ones" if printed_runs else "")
    return Check(what, float(mean), Near(printed, absolute=errors * error, why=why))


def within_error(what: str, value: float, printed: float, *, error: float, why: str, errors: float = ERRORS) -> Check:
    """The value lies within ``errors`` standard errors of the printed one, for a statistic whose error is known."""
    return Check(what, float(value), Near(printed, absolute=errors * error, why=why))


def rank(what: str, runs: Sequence[float] | npt.NDArray[np.float64], printed: float, *, tail: float = TAIL) -> Check:
    """A printed number of one run has runs on either side: the share of emulated runs below it lies in (tail, 1 - tail).

    Sums of squares have skewed laws, of which mean and standard deviation say little; the rank asks nothing of the law. The
    printed run is counted as one of them, (count + 1) / (runs + 1), so that the rule turns a run of the same law away no more
    often than stated. The share of so many runs has an interval, and a share whose interval lies across a limit is undecided.
    What lies beyond all runs by more than their whole range is turned away however few they are.
    """
    values = np.asarray(runs, dtype=float)
    if np.isnan(values).any():
        return Check(what, math.nan, Within(tail, 1.0 - tail))
    reach = float(np.ptp(values))
    if reach > 0.0 and (printed > values.max() + reach or printed < values.min() - reach):
        return Check(what, float(printed > values.max()), Within(tail, 1.0 - tail))
    below, beyond = int((values <= printed).sum()), int((values >= printed).sum())
    if below <= beyond:
        value, interval = (below + 1.0) / (values.size + 1.0), share_interval(below, values.size)
    else:
        value, (low, high) = 1.0 - (beyond + 1.0) / (values.size + 1.0), share_interval(beyond, values.size)
        interval = (1.0 - high, 1.0 - low)
    return Check(what, value, Within(tail, 1.0 - tail), interval)


def share_interval(count: int, runs: int, level: float = LEVEL) -> tuple[float, float]:
    """Interval of Clopper and Pearson for the share of which ``count`` in ``runs`` were found.

    >>> [round(v, 4) for v in share_interval(0, 1000, 0.95)]
    [0.0, 0.0037]
    """
    from scipy.special import betaincinv

    side = 0.5 - 0.5 * level
    low = float(betaincinv(count, runs - count + 1, side)) if count else 0.0
    return low, float(betaincinv(count + 1, runs - count, 1.0 - side)) if count < runs else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One number or claim of a chapter.

    Args:
        item: where it stands and what it is.
        printed: as printed ("-" where the text gives none).
        computed: what came out, in words.
        checks: what must hold for the print to be reproduced; at least one.
        witness: what refutes it if the checks do not hold; empty where a miss is no refutation.
        basis: the assumption that was needed, or the witness in words.

    Raises:
        ValueError: without a check.
    """

    item: str
    printed: str
    computed: str
    checks: tuple[Check, ...]
    witness: tuple[Check, ...] = ()
    basis: str = ""

    def __post_init__(self) -> None:
        if not self.checks:
            raise ValueError(f"row {self.item!r}: no check, so no verdict")

    @property
    def verdict(self) -> Verdict:
        """What follows from the checks."""
        if all(check.holds for check in self.checks):
            return "reproduced"
        if self.witness and all(check.holds for check in self.witness):
            return "claim false"
        failed = any(not check.holds and not check.undecided for check in self.checks)
        return "not reproduced" if failed else "undecided"

    @property
    def rule(self) -> str:
        """The rules in words."""
        held = "; ".join(f"{check.what} {check.rule}" for check in self.checks)
        if not self.witness:
            return held
        return f"{held}. Refuted by: " + "; ".join(f"{check.what} {check.rule}" for check in self.witness)

    def to_json(self) -> dict[str, object]:
        """Item, printed, computed, verdict and basis, and the rule with every computed value beside its own."""
        return {
            "item": self.item, "printed": self.printed, "computed": self.computed, "verdict": self.verdict, "basis": self.basis,
            "rule": self.rule, "checks": [check.to_json() for check in self.checks],
            "witness": [check.to_json() for check in self.witness],
        }  # fmt: skip


def row(item: str, printed: str, *checks: Check, computed: str = "", witness: tuple[Check, ...] = (), basis: str = "") -> Row:
    """A row as it is read: item, printed, checks; ``computed`` is written from the checks and the witness unless given."""
    text = computed or ", ".join(dict.fromkeys(str(check) for check in (*checks, *witness)))
    return Row(item=item, printed=printed, computed=text, checks=checks, witness=witness, basis=basis)
