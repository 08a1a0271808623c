"""A statement of the thesis as data: what is said, what is printed, which computed number, by which rule.

A chapter computes numbers under names; a table of statements refers to them as a format string does, ``"J[1]"``, and
`judge` puts the two together. Words may quote numbers in braces. No statement has code of its own::

    statement("J of (5.16)", "220.2", equal("J for I(0) = 2", "J[1]", "220.2"), basis="others: {J[0]:.3f}")
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from string import Formatter
from typing import Any

from msgspec import Struct

from hil.thesis.judgement import Approximately, Between, Check, Equals, NotJudged, Row, Rule, rank

ERRORS = 4.0
"""Standard errors that a Monte-Carlo mean may be off: two-sided error rate 6e-5 for a normal mean."""

Values = Mapping[str, Any]
Number = float | str
"""A number, or the name of one."""


class _Numbers(Formatter):
    """Looks numbers up by name, and writes them into words; one that a computation did not find (None) is NaN."""

    def get_field(self, field_name: str, args: Sequence[Any], kwargs: Values) -> Any:
        value, first = super().get_field(field_name, args, kwargs)
        return math.nan if value is None else value, first


def named(values: Values, name: Number) -> Any:
    """Return the value of a name such as ``"J[1]"`` or ``"fit.inertia"``, NaN for None; a number is itself.

    Raises:
        KeyError, AttributeError, IndexError: there is none.
    """
    return _Numbers().get_field(name, (), values)[0] if isinstance(name, str) else name


def number_of(value: float | None) -> float:
    """Return a number to compute with, NaN where there is none."""
    return math.nan if value is None else value


class Claim(Struct, frozen=True):
    """A number and the rule that it is judged by.

    Args:
        what: what the number is, with its unit.
        name: its name among the computed values.
        judged: makes the check of it, from what, number and all values.
    """

    what: str
    name: str
    judged: Callable[[str, Any, Values], Check]


class Statement(Struct, frozen=True):
    """A row before its numbers are computed; see `hil.thesis.judgement.Row`."""

    item: str
    printed: str
    claims: tuple[Claim, ...]
    witness: tuple[Claim, ...] = ()
    beside: tuple[Claim, ...] = ()
    computed: str = ""
    basis: str = ""
    readings: bool = False


def statement(
    item: str, printed: str, *claims: Claim, witness: tuple[Claim, ...] = (), beside: tuple[Claim, ...] = (), computed: str = "",
    basis: str = "", readings: bool = False,
) -> Statement:  # fmt: skip
    """Return a statement that holds where its claims do; for the rest see `hil.thesis.judgement.Row`."""
    return Statement(item, printed, claims, witness, beside, computed, basis, readings)


def judge(statements: Sequence[Statement], values: Values) -> tuple[Row, ...]:
    """Return a row for each statement; ``computed`` is written from the checks unless the statement gives it.

    Raises:
        KeyError: a statement names a number that was not computed.
    """
    return tuple(_row(each, values) for each in statements)


def _row(said: Statement, values: Values) -> Row:
    def words(text: str) -> str:
        return _Numbers().vformat(text, (), values)

    checks, witness, beside = (
        tuple(c.judged(words(c.what), named(values, c.name), values) for c in claims)
        for claims in (said.claims, said.witness, said.beside)
    )
    computed, basis = words(said.computed), words(said.basis)
    computed = computed or ", ".join(dict.fromkeys(str(check) for check in (*checks, *witness)))
    return Row(
        item=said.item, printed=said.printed, computed=computed, checks=checks, witness=witness, beside=beside, basis=basis,
        readings=said.readings,
    )  # fmt: skip


def _claim(what: str, name: str, rule: Callable[[Values], Rule]) -> Claim:
    return Claim(what, name, lambda said, value, v: Check(said, value if isinstance(value, str) else float(value), rule(v)))


def last_digit(printed: str) -> float:
    """Return one unit of the last printed digit.

    >>> last_digit("220.2"), last_digit("-.0342"), last_digit("20")
    (0.1, 0.0001, 1.0)
    """
    return float(f"1e-{len(printed.partition('.')[2])}")


def equal(what: str, name: str, printed: str, rounding: Number = 0.0) -> Claim:
    """The number is the printed one: to half a unit of its last digit, and to what the rounding of printed data moves it."""
    why = "half a unit of the last printed digit" + (", and the rounding of the printed gains" if rounding else "")
    slack = 1.0 + 1e-9  # 0.05 is no binary fraction
    half = 0.5 * last_digit(printed) * slack
    return _claim(what, name, lambda v: Approximately(float(printed), half + named(v, rounding), why))


def exactly(what: str, name: str, target: Number, tolerance: float = 0.0, scale: Number = 1.0) -> Claim:
    """The number is another one or a count; ``tolerance`` is that of the arithmetic, ``scale`` see `Approximately`."""
    return _claim(what, name, lambda v: Approximately(float(named(v, target)), tolerance, "", float(named(v, scale))))


def mean(what: str, name: str, printed: str, *, error: str, why: str) -> Claim:
    """A statistic of standard error ``error`` lies within four of them of the printed number."""
    said = f"{ERRORS:g} standard errors: {why}"
    return _claim(what, name, lambda v: Approximately(float(printed), ERRORS * float(named(v, error)), said))


def run(what: str, name: str, printed: str) -> Claim:
    """The printed number, of one run, is one of the computed runs."""
    return Claim(what, name, lambda said, value, v: rank(said, value, float(printed)))


def below(what: str, name: str, limit: Number) -> Claim:
    """The number is less than a limit."""
    return _claim(what, name, lambda v: Between(high=float(named(v, limit))))


def above(what: str, name: str, limit: Number) -> Claim:
    """The number is greater than a limit."""
    return _claim(what, name, lambda v: Between(low=float(named(v, limit))))


def within(what: str, name: str, low: float, high: float) -> Claim:
    """The number lies between two limits."""
    return _claim(what, name, lambda v: Between(low, high))


def says(what: str, name: str, word: str) -> Claim:
    """A computation (a certificate, a search) says this word."""
    return _claim(what, name, lambda v: Equals(word))


def not_judged(what: str, name: str, why: str) -> Claim:
    """The number is shown and cannot be judged."""
    return _claim(what, name, lambda v: NotJudged(why))
