"""What holds for every row of every chapter: each of its numbers, when it is wrong, turns the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from msgspec.structs import replace

from hil.thesis.judgement import OFF, Approximately, Check, Drawn, Equals, NotJudged, Row
from hil.thesis.pages import turns

FACTORS = (-1e6, -10.0, -1.0, 0.0, 0.1, 0.5, 0.9, 0.99, 1.01, 1.1, 2.0, 10.0, 1e6)
WORDS = ("certified", "refused", "undecided", "feasible", "found", "not found")


def others(check: Check) -> Iterator[Check]:
    """The check with another value: words for words, and numbers from near to far, also around its limits."""
    if isinstance(check.rule, Drawn):  # with the power that the runs at hand may lack
        yield from (replace(check, value=share, rule=Drawn(check.rule.tail), interval=()) for share in (0.0, 0.5, 1.0))
        return
    if isinstance(check.value, str):
        words = (*WORDS, check.rule.word) if isinstance(check.rule, Equals) else WORDS
        yield from (replace(check, value=word, interval=()) for word in words if word != check.value)
        return
    if isinstance(check.rule, Approximately) and check.rule.says(check.rule.printed) is None:  # wide: as with more runs
        check = replace(check, rule=replace(check.rule, tolerance=0.25 * OFF * check.rule.size))
    start = check.value if math.isfinite(check.value) else 1.0
    limits = [float(v) for v in (getattr(check.rule, n, math.nan) for n in ("printed", "low", "high")) if math.isfinite(v)]
    middle = [sum(limits) / len(limits)] if limits else []
    around = [v + s * max(abs(v), 1e-3) * 1e-3 for v in limits for s in (-1, 1)]
    for value in (*limits, *middle, *around, *(start * f for f in FACTORS), *(start + f for f in FACTORS)):
        yield replace(check, value=value, interval=())


def with_outcome(check: Check, holds: bool) -> Check:
    """The check, or one of its perturbations, that holds or does not."""
    for other in (check, *others(check)):
        if other.outcome is holds:
            return other
    raise AssertionError(f"no value of {check.what!r} {'meets' if holds else 'breaks'} {check.rule}: it judges nothing")


def assert_every_number_decides(rows: Iterable[Row]) -> None:
    """Each check alone turns a row whose other checks hold; each check of a witness alone takes the refutation back.

    What cannot be judged leaves its row undecided. A reproduced row turns with each of its equalities that
    is 10 % off, both ways.
    """
    for row in rows:
        if any(isinstance(check.rule, NotJudged) for check in row.checks):
            assert row.verdict != "reproduced", row.item
            continue
        good = tuple(with_outcome(check, True) for check in row.checks)
        bad = tuple(with_outcome(check, False) for check in row.checks)
        wrong = "undecided" if row.readings and len(row.checks) > 1 else "not reproduced"
        assert replace(row, checks=good, witness=()).verdict == "reproduced", row.item
        for k in range(len(good)):
            broken = (*good[:k], bad[k], *good[k + 1 :])
            assert replace(row, checks=broken, witness=()).verdict == wrong, (row.item, row.checks[k].what)
        if row.witness:
            refuted = tuple(with_outcome(check, True) for check in row.witness)
            assert replace(row, checks=bad, witness=refuted).verdict == "claim false", row.item
            for k, check in enumerate(row.witness):
                missing = (*refuted[:k], with_outcome(check, False), *refuted[k + 1 :])
                assert replace(row, checks=bad, witness=missing).verdict == "not reproduced", (row.item, check.what)
        for check in (*row.checks, *row.witness):
            if not isinstance(check.value, str):
                assert not replace(check, value=math.nan, interval=()).holds, (row.item, check.what)
    assert_equalities_turn(rows)


def assert_equalities_turn(rows: Iterable[Row]) -> None:
    """A reproduced row turns when one of its equalities, alone, is 10 % larger, and when it is 10 % smaller."""
    for row in rows:
        for check in row.checks:
            if check.rule.kind == "equality" and row.verdict == "reproduced":
                others = tuple(each for each in row.checks if each is not check)
                for share in (-OFF, OFF):
                    assert turns(replace(row, checks=(check,)), share), (row.item, check.what)
                    moved = check.off(share)
                    assert moved is not None
                    assert replace(row, checks=(moved, *others), witness=()).verdict != "reproduced", (row.item, check.what)
