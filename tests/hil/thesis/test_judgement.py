"""Verdicts follow from numbers: the rules, what a wrong number does, and that no statement is given its verdict."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from hil.thesis.judgement import OFF, Between, Check, Row, rank, share_interval
from hil.thesis.pages import power, power_in_words, turns
from hil.thesis.statements import (
    Claim,
    Statement,
    above,
    below,
    equal,
    exactly,
    judge,
    last_digit,
    mean,
    not_judged,
    run,
    says,
    within,
)
from tests.hil.thesis.judging import assert_equalities_turn, assert_every_number_decides


def row(*claims: Claim, witness: tuple[Claim, ...] = (), printed: str = "1", readings: bool = False, **values: Any) -> Row:
    return judge([Statement("a", printed, claims, witness, readings=readings)], values)[0]


def test_verdicts_and_what_leads_to_each() -> None:
    claim = below("radius", "r", 1)
    assert row(claim, r=0.9).verdict == "reproduced"
    assert row(claim, r=1.1).verdict == "not reproduced"
    witness = (above("radius", "r", 1), says("by", "by", "us"))
    assert row(claim, witness=witness, r=1.1, by="us").verdict == "claim false"
    assert row(claim, witness=witness, r=1.1, by="no").verdict == "not reproduced"
    assert row(claim, witness=witness, r=0.9, by="us").verdict == "reproduced"


def test_a_check_that_is_off_has_a_larger_or_smaller_number_by_that_share() -> None:
    checks = row(equal("x", "x", "2.0"), exactly("z", "z", 0, 0.1, 5.0), says("w", "w", "us"), x=2.02, z=0.01, w="us").checks
    for share in (0.1, -0.1):
        x, z, word = (check.off(share) for check in checks)
        assert x is not None and x.value == pytest.approx(2.02 * (1.0 + share))
        assert z is not None and z.value == pytest.approx(0.01 + share * 5.0) and word is None


def test_a_row_without_a_check_is_refused() -> None:
    with pytest.raises(ValueError, match="no check"):
        Row(item="a", printed="1", computed="1", checks=())


@pytest.mark.parametrize(
    ("printed", "unit"), [("220.2", 0.1), ("-.0342", 1e-4), ("20", 1.0), ("0.2320", 1e-4), ("9.9100", 1e-4), ("17.4085", 1e-4)]
)
def test_the_tolerance_is_half_a_unit_of_the_last_printed_digit(printed: str, unit: float) -> None:
    assert last_digit(printed) == unit
    for off, verdict in ((0.49, "reproduced"), (-0.49, "reproduced"), (0.51, "not reproduced"), (-0.51, "not reproduced")):
        assert row(equal("x", "x", printed), x=float(printed) + off * unit).verdict == verdict
    rounded = equal("x", "x", printed, "moved")
    assert row(rounded, x=float(printed) + 0.7 * unit, moved=0.25 * unit).verdict == "reproduced"
    assert row(rounded, x=float(printed) + 0.8 * unit, moved=0.25 * unit).verdict == "not reproduced"


def test_the_other_rules_are_the_ones_stated() -> None:
    assert row(exactly("n", "n", 15), n=15).verdict == "reproduced"
    assert row(exactly("n", "n", 15), n=16).verdict == "not reproduced"
    assert row(exactly("x", "x", "y", 1e-6), x=2.0, y=2.0 + 1e-7).verdict == "reproduced"
    assert row(exactly("z", "z", 0, 0.06), z=0.0).verdict == "undecided"  # of the size 1: a tenth of it would fulfil it too
    assert row(within("x", "x", 0, 1), x=0.5).verdict == "reproduced"
    assert row(within("x", "x", 0, 1), x=1.0).verdict == "not reproduced"
    for word, verdict in (("certified", "reproduced"), ("refused", "not reproduced"), ("undecided", "undecided")):
        assert row(says("w", "w", "certified"), w=word).verdict == verdict
    for claim in (below("x", "x", 1), above("x", "x", 1), equal("x", "x", "1.00")):
        assert row(claim, x=float("nan")).verdict == "not reproduced"
    four = mean("mean", "x", "10.0", error="error", why="")
    assert row(four, x=10.079, error=0.02).verdict == "reproduced" and row(four, x=10.081, error=0.02).verdict == "not reproduced"


def test_an_equality_that_a_number_ten_percent_off_would_fulfil_decides_nothing() -> None:
    wide = mean("mean", "x", "10.0", error="error", why="")
    assert row(wide, x=10.0, error=0.11).verdict == "reproduced"  # tolerance 0.44: 11.0 and 9.0 fail
    assert row(wide, x=10.0, error=0.13).verdict == "undecided"  # 0.52: 9.54 passes, and so does it if it is 10 % larger
    assert row(wide, x=13.0, error=0.13).verdict == "not reproduced"  # what fails a wide rule fails
    for error in np.linspace(0.0, 0.3, 301):
        found = row(wide, x=10.0 - 3.99 * error, error=error)
        if found.verdict == "reproduced":
            assert_equalities_turn([found])
    assert row(equal("x", "x", "2"), x=2.0).verdict == "undecided"  # one digit: 1.6 and 2.4 are printed so too


def test_a_run_among_runs_of_any_size_decides_nothing() -> None:
    """The law of Table 7.1's local controller spans seven decades: the printed number is one of it, and so is any other."""
    wide = np.exp(4.0 * np.random.default_rng(0).standard_normal(10_000))
    for printed in ("0.01", "0.3319", "100", "5000"):
        assert row(run("share", "x", printed), x=wide).verdict == "undecided"
    assert row(run("share", "x", "1000000000"), x=wide).verdict == "not reproduced"
    narrow = 10.0 + np.random.default_rng(1).standard_normal(10_000)
    assert row(run("share", "x", "10.5"), x=narrow).verdict == "reproduced"
    for size in (0.5, 2.0):
        assert row(run("share", "x", "10.5"), x=size * narrow).verdict == "not reproduced"
    one_side = np.abs(np.random.default_rng(2).standard_normal(10_000))  # half the size is turned away and twice the size is not
    found = row(run("share", "x", "2.6"), x=one_side)
    assert found.verdict == "undecided" and "passes at the size 2" in found.rule


def test_a_number_under_settings_that_are_not_printed_is_judged_once() -> None:
    claims = tuple(below(f"with setting {n}", f"x[{n}]", 1) for n in range(3))
    cases = (([0, 0, 0], "reproduced"), ([2, 2, 2], "not reproduced"), ([0, 2, 2], "undecided"), ([0, 0, 2], "undecided"))
    for x, verdict in cases:
        found = row(*claims, readings=True, x=x)
        assert found.verdict == verdict and "not printed" in found.rule


def test_what_is_not_at_hand_cannot_be_judged() -> None:
    old = not_judged("CPU time", "seconds", "the PC is not at hand")
    assert row(old, seconds=0.01).verdict == "undecided" and "not at hand" in row(old, seconds=0.01).rule
    assert row(old, says("gains", "gains", "certified"), seconds=0.01, gains="refused").verdict == "not reproduced"


def test_what_stands_beside_is_shown_and_decides_nothing() -> None:
    said = [Statement("a", "1", (equal("x", "x", "1.00"),), beside=(equal("at half the period", "y", "1.00"),))]
    for x, y, verdict in ((1.0, 2.0, "reproduced"), (2.0, 1.0, "not reproduced")):
        (found,) = judge(said, {"x": x, "y": y})
        assert found.verdict == verdict and "Beside, not judged: at half the period" in found.rule
        beside: Any = found.to_json()["beside"]
        assert beside[0]["value"] == y and beside[0]["holds"] is (y == 1.0)


def test_the_share_that_turns_is_counted_by_kind() -> None:
    rows = [
        row(equal("x", "x", "220.2"), x=220.2), row(equal("x", "x", "220.2"), x=200.0),
        row(below("x", "x", 1), above("x", "x", 0.9), x=0.95),
        row(below("x", "x", 1), x=0.95), row(says("w", "w", "yes"), w="yes"), row(within("x", "x", 0.9, 1.1), x=0.999),
        row(exactly("n", "n", 0), n=0),
    ]  # fmt: skip
    assert power(rows) == {"equality": (2, 2), "one run": (0, 0), "one-sided": (1, 3)}
    assert turns(rows[2], OFF) and turns(rows[2], -OFF) and not turns(rows[4], OFF) and not turns(rows[5], 0.01)
    assert "turns 3 of 5 reproduced rows with numbers: 2 of 2 equality" in power_in_words(rows)


def test_a_printed_run_is_judged_by_its_rank_whatever_the_law() -> None:
    """Level: a run of the same law is turned away 1 time in 100. Power: one at the 0.9999 quantile always is."""
    rng = np.random.default_rng(0)
    skewed = 20.0 + np.exp(rng.standard_normal(4000))
    drawn = 20.0 + np.exp(rng.standard_normal(1000))
    found = [rank("share", skewed, value) for value in drawn]
    turned_away, unsure = (float(np.mean(said)) for said in ([not c.holds for c in found], [c.undecided for c in found]))
    assert turned_away - unsure < 0.01 + 4.0 * (0.01 * 0.99 / 1000) ** 0.5 and 0.0 < unsure < 0.03
    for size in (3.72, -3.72):
        assert not rank("share", skewed, float(20.0 + np.exp(size))).holds
    # mean +- 2.6 sd, which stood here before, would take every small value and turn away too many of the large ones
    assert not abs(20.0 + np.exp(-3.72) - skewed.mean()) > 2.6 * skewed.std()
    assert not rank("share", [1.0] * 40 + [np.inf] * 80, 2.0, tail=0.1).holds and not rank("share", [1.0, np.nan], 2.0).holds


def test_few_runs_decide_nothing_and_enough_do() -> None:
    """0 of n runs: the interval of the share reaches up to 1 - 0.005^(1/n), which is below 0.005 from 1058 runs on."""
    for printed in (2.0, 0.0):
        few, many = rank("share", np.ones(1057), printed), rank("share", np.ones(1058), printed)
        assert few.undecided and not few.holds and not many.undecided and not many.holds
        assert judged(few) == "undecided" and judged(many) == "not reproduced"
    inside = rank("share", np.arange(1000.0, 1500.0), 1250.0)
    assert inside.holds and judged(inside, rank("share", np.ones(60), 2.0)) == "undecided"
    assert judged(replace(inside, rule=Between(high=0.1)), rank("share", np.ones(60), 2.0)) == "not reproduced"


def judged(*checks: Check) -> str:
    return Row(item="a", printed="1", computed="", checks=checks).verdict


def test_the_interval_of_a_share_holds_the_share() -> None:
    """Level 99 %: of 4000 samples of 500 at most 1 % miss, and 4 standard errors more; one of half the level would miss 5 %."""
    rng = np.random.default_rng(2)
    counts = rng.binomial(500, 0.01, 4000)
    missed = np.mean([not low <= 0.01 <= high for low, high in (share_interval(int(c), 500) for c in counts)])
    assert missed < 0.01 + 4.0 * (0.01 * 0.99 / 4000) ** 0.5


def test_the_row_says_its_rule_its_kind_and_its_numbers() -> None:
    found = row(equal("norm", "x", "0.20"), witness=(above("norm", "x", 0.2),), x=0.25).to_json()
    assert found["verdict"] == "claim false"
    assert found["rule"] == "equality: norm within 0.005 of 0.2 (half a unit of the last printed digit). Refuted by: norm > 0.2"
    checks: Any = found["checks"]
    assert checks[0] | {"rule": ""} == {
        "what": "norm", "value": 0.25, "kind": "equality", "rule": "", "holds": False, "undecided": False,
    }  # fmt: skip
    assert {"item", "printed", "computed", "verdict", "basis"} <= set(found)
    assert row(below("x", "x", 1), x=0.5).rule == "one-sided: x < 1"


def test_a_number_that_judges_nothing_is_found_out() -> None:
    assert_every_number_decides([row(equal("x", "x", "1.00"), below("y", "y", 2), x=1.0, y=3.0)])
    with pytest.raises(AssertionError, match="judges nothing"):
        assert_every_number_decides([row(within("x", "x", float("-inf"), float("inf")), x=1.0)])


def test_a_print_far_beyond_a_few_runs_is_not_one_of_them() -> None:
    """Fewer runs than 1 / tail leave no rank outside it; a print three standard ranges away is none of them all the same."""
    runs = [0.12, 0.13, 0.14]
    for printed, unsure in ((0.13, True), (0.155, True), (0.4606, False), (0.01, False)):
        assert rank("share", runs, printed).undecided is unsure and not rank("share", runs, printed).holds
