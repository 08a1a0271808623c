"""How a verdict comes about: computed numbers, each with a rule, and nothing else.

A `Row` is one number or claim of a chapter. It carries *checks*, which say what would have to be true for the print to hold,
and, for a claim that we say is wrong, the *witness*: checks that refute it.

    all checks hold                      ->  reproduced
    else, all checks of the witness hold ->  claim false
    else, a check fails                  ->  not reproduced
    else                                 ->  undecided

There is one rule for each kind of number, and its kind stands beside it:

    equality    a printed number, to half a unit of its last digit; a mean of runs, to four standard errors (`Approximately`)
    one run     a printed run among ours: error rate 1 %, and power against runs of half or twice the size (`Drawn`)
    one-sided   a limit or an interval (`Between`)
    word        what a certificate or a search says, never one that we write down (`Equals`)
    not judged  a number that is shown and not judged, because what it depends on is not at hand (`NotJudged`)

A check is undecided, and so decides nothing, where the data cannot tell: a statistic whose interval lies across the limit, an
equality that a number 10 % off would fulfil, a run that would also be one of runs of half or twice the size, a certificate that
is undecided itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import replace

Verdict = Literal["reproduced", "not reproduced", "claim false", "undecided"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
Kind = Literal["equality", "one run", "one-sided", "word", "not judged"]
Value = float | str

OFF = 0.1
"""An equality that a number this share off would fulfil decides nothing."""

TAIL = 0.005
"""Share of emulated runs that must lie on either side of a printed run: two-sided error rate 1 %, whatever the law."""

SIZES = (0.5, 2.0)
"""A printed run that is also one of runs of these sizes, beside ours, decides nothing."""

LEVEL = 0.99
"""Of the interval of a share of runs (Clopper and Pearson)."""


class Approximately(Struct, frozen=True, tag=True):
    """|value - printed| <= tolerance; ``scale`` is the size of what is compared where ``printed`` is 0."""

    kind: ClassVar[Kind] = "equality"
    printed: float
    tolerance: float = 0.0
    why: str = ""
    scale: float = 1.0

    @property
    def size(self) -> float:
        """Of the number that is compared."""
        return abs(self.printed) or self.scale

    def says(self, value: Value) -> bool | None:
        """See `Rule`; None for a value that fulfils it where one that is `OFF` could too."""
        if not abs(float(value) - self.printed) <= self.tolerance:
            return False
        return True if (2.0 + OFF) * self.tolerance < OFF * self.size else None

    def __str__(self) -> str:
        return f"within {self.tolerance:.3g} of {self.printed:.6g}" + (f" ({self.why})" if self.why else "")


class Between(Struct, frozen=True, tag=True):
    """low < value < high."""

    kind: ClassVar[Kind] = "one-sided"
    low: float = -math.inf
    high: float = math.inf

    def says(self, value: Value) -> bool | None:
        """See `Rule`."""
        return self.low < float(value) < self.high

    def __str__(self) -> str:
        if math.isinf(self.low):
            return f"< {self.high:g}"
        return f"> {self.low:g}" if math.isinf(self.high) else f"between {self.low:g} and {self.high:g}"


class Drawn(Struct, frozen=True, tag=True):
    """tail < share of our runs below the printed one < 1 - tail; ``passes``: sizes of our runs at which it would hold too."""

    kind: ClassVar[Kind] = "one run"
    tail: float = TAIL
    passes: tuple[float, ...] = ()

    def says(self, value: Value) -> bool | None:
        """See `Rule`; None for a share that fulfils it where runs of half or twice the size do too."""
        if not self.tail < float(value) < 1.0 - self.tail:
            return False
        return None if set(SIZES) & set(self.passes) else True

    def __str__(self) -> str:
        without = "; passes at the size {}, so it decides nothing".format(", ".join(f"{s:g}" for s in SIZES if s in self.passes))
        power = without if set(SIZES) & set(self.passes) else "; turned away at half and at twice the size"
        return f"between {self.tail:g} and {1.0 - self.tail:g} (error rate {2.0 * self.tail:.0%}{power})"


class Equals(Struct, frozen=True, tag=True):
    """The value is this word."""

    kind: ClassVar[Kind] = "word"
    word: str

    def says(self, value: Value) -> bool | None:
        """See `Rule`; None where a proof or a search is undecided and another word was expected."""
        return None if value == "undecided" != self.word else value == self.word

    def __str__(self) -> str:
        return f"is {self.word!r}"


class NotJudged(Struct, frozen=True, tag=True):
    """The value cannot be judged."""

    kind: ClassVar[Kind] = "not judged"
    why: str

    def says(self, value: Value) -> bool | None:
        """See `Rule`."""
        return None

    def __str__(self) -> str:
        return f"cannot be judged: {self.why}"


Rule: TypeAlias = Approximately | Between | Drawn | Equals | NotJudged
"""What a computed value must fulfil: its `kind`, and what it `says` of a value, None where that is not known; NaN never does."""


class Check(Struct, frozen=True):
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
    interval: tuple[float, ...] = ()

    @property
    def outcome(self) -> bool | None:
        """Whether the value, and all of its interval, fulfils the rule; None where the data cannot tell."""
        said = {self.rule.says(value) for value in (self.value, *self.interval)}
        return said.pop() if len(said) == 1 else None

    @property
    def holds(self) -> bool:
        """Whether the rule is fulfilled."""
        return self.outcome is True

    @property
    def undecided(self) -> bool:
        """Whether the data cannot tell."""
        return self.outcome is None

    def off(self, share: float) -> Check | None:
        """The check if the computed number were this share larger; None for a word and for a run that has no such record."""
        if isinstance(self.rule, Drawn):
            passes = 1.0 + share in self.rule.passes
            return replace(self, value=0.5 if passes else math.nan, interval=())
        if isinstance(self.value, str) or isinstance(self.rule, NotJudged):
            return None
        zero = isinstance(self.rule, Approximately) and self.rule.printed == 0.0
        size = self.rule.size if zero and isinstance(self.rule, Approximately) else abs(self.value)
        return replace(self, value=self.value + share * size, interval=())

    def __str__(self) -> str:
        text = f"{self.what} {self.value if isinstance(self.value, str) else format(self.value, '.4g')}"
        return text + (f" [{self.interval[0]:.2g}, {self.interval[1]:.2g}]" if self.interval else "")

    def to_json(self) -> dict[str, object]:
        """What, value (None if it is not finite), kind, rule and whether it holds; of a statistic the interval too."""
        value = self.value if isinstance(self.value, str) or math.isfinite(self.value) else None
        found: dict[str, object] = {"what": self.what, "value": value, "kind": self.rule.kind, "rule": str(self.rule)}
        found |= {"holds": self.holds, "undecided": self.undecided}
        return found | ({"interval": list(self.interval)} if self.interval else {})


def rank(what: str, runs: Sequence[float] | npt.NDArray[np.float64], printed: float, *, tail: float = TAIL) -> Check:
    """A printed number of one run has runs on either side: the share of emulated runs below it lies in (tail, 1 - tail).

    Sums of squares have skewed laws, of which mean and standard deviation say little; the rank asks nothing of the law. The
    printed run is counted as one of them, (count + 1) / (runs + 1), so that the rule turns a run of the same law away no more
    often than stated. The share of so many runs has an interval, and a share whose interval lies across a limit is undecided.
    What lies beyond all runs by more than their whole range is turned away however few they are. Power: the same test over
    runs of half and of twice the size must turn the printed number away, or the check is undecided.
    """
    values = np.asarray(runs, dtype=float)
    passes = tuple(size for size in (*SIZES, 1.0 - OFF, 1.0 + OFF) if _share(what, size * values, printed, Drawn(tail)).holds)
    return _share(what, values, printed, Drawn(tail, passes))


def _share(what: str, values: npt.NDArray[np.float64], printed: float, rule: Drawn) -> Check:
    if np.isnan(values).any():
        return Check(what, math.nan, rule)
    reach = float(np.ptp(values)) if np.isfinite(values).all() else math.inf
    above = printed > values.max() + reach
    if reach > 0.0 and (above or printed < values.min() - reach):
        return Check(what, float(above), rule)
    below, beyond = int((values <= printed).sum()), int((values >= printed).sum())
    if below <= beyond:
        value, interval = (below + 1.0) / (values.size + 1.0), share_interval(below, values.size)
    else:
        value, (low, high) = 1.0 - (beyond + 1.0) / (values.size + 1.0), share_interval(beyond, values.size)
        interval = (1.0 - high, 1.0 - low)
    return Check(what, value, rule, interval)


def share_interval(count: int, runs: int) -> tuple[float, float]:
    """Return Clopper and Pearson's interval of level `LEVEL` for a probability, of ``count`` successes in ``runs``.

    >>> [round(v, 4) for v in share_interval(0, 1000)]
    [0.0, 0.0053]
    """
    from transport.law_fit.proportions import clopper_pearson

    low, high = clopper_pearson(np.array(count), np.array(runs), 1.0 - LEVEL)
    return float(low), float(high)


class Row(Struct, frozen=True, kw_only=True):
    """One number or claim of a chapter, judged.

    Args:
        item: where it stands and what it is.
        printed: as printed ("-" where the text gives none).
        computed: what came out, in words.
        checks: what must hold for the print to be reproduced; at least one.
        witness: what refutes it if the checks do not hold; empty where a miss is no refutation.
        beside: the same number under settings other than the printed ones; shown, and no part of the verdict.
        basis: the assumption that was needed, or the witness in words.
        readings: the checks are the same number under settings that are not printed: where they differ nothing is decided.

    Raises:
        ValueError: without a check.
    """

    item: str
    printed: str
    computed: str
    checks: tuple[Check, ...]
    witness: tuple[Check, ...] = ()
    beside: tuple[Check, ...] = ()
    basis: str = ""
    readings: bool = False

    def __post_init__(self) -> None:
        if not self.checks:
            raise ValueError(f"row {self.item!r}: no check, so no verdict")

    @property
    def verdict(self) -> Verdict:
        """What follows from the checks."""
        outcomes = {check.outcome for check in self.checks}
        if outcomes == {True}:
            return "reproduced"
        if self.witness and all(check.holds for check in self.witness):
            return "claim false"
        fails = outcomes == {False} if self.readings else False in outcomes
        return "not reproduced" if fails else "undecided"

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """Kinds of the checks, each once."""
        return tuple(dict.fromkeys(check.rule.kind for check in self.checks))

    @property
    def rule(self) -> str:
        """The kinds and the rules in words."""
        held = f"{', '.join(self.kinds)}: " + "; ".join(f"{check.what} {check.rule}" for check in self.checks)
        if self.readings:
            held += " (settings that are not printed: decided only where all say the same)"
        for word, checks in (("Refuted by", self.witness), ("Beside, not judged", self.beside)):
            if checks:
                held += f". {word}: " + "; ".join(f"{check.what} {check.rule}" for check in checks)
        return held

    def to_json(self) -> dict[str, object]:
        """Item, printed, computed, verdict and basis, and the rule with every computed value beside its own."""
        return {
            "item": self.item, "printed": self.printed, "computed": self.computed, "verdict": self.verdict, "basis": self.basis,
            "rule": self.rule, "checks": [check.to_json() for check in self.checks],
            "witness": [check.to_json() for check in self.witness], "beside": [check.to_json() for check in self.beside],
        }  # fmt: skip
