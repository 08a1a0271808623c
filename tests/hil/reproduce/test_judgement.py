"""Verdicts follow from numbers: the rules, what a wrong number does, and that no row is given its verdict."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import hil.reproduce
from hil.reproduce import VERDICTS
from hil.reproduce.judgement import Row, above, below, near, rank, row, says, share_interval, standard_errors, within
from tests.hil.reproduce.judging import assert_every_number_decides

ROOM = Path(hil.reproduce.__file__).parent
HELPERS = ("near", "below", "above", "within", "says", "standard_errors", "within_error", "rank")


def test_verdicts_and_what_leads_to_each() -> None:
    claim = (below("radius", 0.9, 1.0),)
    assert row("a", "stable", *claim).verdict == "reproduced"
    assert row("a", "stable", below("radius", 1.1, 1.0)).verdict == "not reproduced"
    refuted = row("a", "stable", below("radius", 1.1, 1.0), witness=(above("radius", 1.1, 1.0), says("by", "us", "us")))
    assert refuted.verdict == "claim false"
    unproved = row("a", "stable", below("radius", 1.1, 1.0), witness=(above("radius", 1.1, 1.0), says("by", "no", "us")))
    assert unproved.verdict == "not reproduced"
    assert row("a", "stable", *claim, witness=(above("radius", 0.9, 1.0),)).verdict == "reproduced"


def test_a_row_without_a_check_is_refused() -> None:
    with pytest.raises(ValueError, match="no check"):
        Row(item="a", printed="1", computed="1", checks=())


def test_tolerances_are_the_ones_stated() -> None:
    assert near("x", 0.1224, 0.1225, absolute=0.00011).holds and not near("x", 0.1224, 0.1225, absolute=0.00009).holds
    assert near("x", 102.0, 100.0, relative=0.03).holds and not near("x", 104.0, 100.0, relative=0.03).holds
    assert not near("x", 1.0 + 1e-12, 1.0).holds
    assert within("x", 0.5, 0.0, 1.0).holds and not within("x", 1.0, 0.0, 1.0).holds
    assert not below("x", float("nan"), 1.0).holds and not above("x", float("nan"), 1.0).holds


def test_standard_errors_count_both_samples() -> None:
    inside = {"sd": 2.0, "runs": 10_000}
    assert standard_errors("mean", 10.079, 10.0, **inside).holds and not standard_errors("mean", 10.081, 10.0, **inside).holds
    both = {**inside, "printed_runs": 10_000}
    assert standard_errors("mean", 10.113, 10.0, **both).holds and not standard_errors("mean", 10.114, 10.0, **both).holds


def test_a_printed_run_is_judged_by_its_rank_whatever_the_law() -> None:
    """Level: a run of the same law is turned away 1 time in 100. Power: one at the 0.9999 quantile always is."""
    rng = np.random.default_rng(0)
    skewed = np.exp(rng.standard_normal(10_000))
    drawn = np.exp(rng.standard_normal(2000))
    found = [rank("share", skewed, value) for value in drawn]
    turned_away, unsure = (float(np.mean(said)) for said in ([not c.holds for c in found], [c.undecided for c in found]))
    assert turned_away - unsure < 0.01 + 4.0 * (0.01 * 0.99 / 2000) ** 0.5 and 0.0 < unsure < 0.02
    assert not rank("share", skewed, float(np.exp(3.72))).holds and not rank("share", skewed, float(np.exp(-3.72))).holds
    # mean +- 2.6 sd, which stood here before, would take every small value and turn away too many of the large ones
    assert not abs(np.exp(-3.72) - skewed.mean()) > 2.6 * skewed.std()
    assert rank("share", [1.0] * 40 + [np.inf] * 80, 2.0, tail=0.1).holds and not rank("share", [1.0, np.nan], 2.0).holds


def test_few_runs_decide_nothing_and_enough_do() -> None:
    """0 of n runs: the interval of the share reaches up to 1 - 0.005^(1/n), which is below 0.005 from 1058 runs on."""
    for printed in (2.0, 0.0):
        few, many = rank("share", np.ones(1057), printed), rank("share", np.ones(1058), printed)
        assert few.undecided and not few.holds and not many.undecided and not many.holds
        assert row("a", "1", few).verdict == "undecided" and row("a", "1", many).verdict == "not reproduced"
    inside = rank("share", np.arange(1000.0), 500.0)
    assert inside.holds and row("a", "1", inside, rank("share", np.ones(60), 2.0)).verdict == "undecided"
    assert row("a", "1", below("x", inside.value, 0.1), rank("share", np.ones(60), 2.0)).verdict == "not reproduced"
    refuted = row("a", "1", rank("share", np.ones(60), 2.0), witness=(above("x", inside.value, 0.1),))
    assert refuted.verdict == "claim false"


def test_the_interval_of_a_share_holds_the_share() -> None:
    """Level 99 %: of 4000 samples of 500 at most 1 % miss, and 4 standard errors more; one of half the level would miss 5 %."""
    rng = np.random.default_rng(2)
    counts = rng.binomial(500, 0.01, 4000)
    missed = np.mean([not low <= 0.01 <= high for low, high in (share_interval(int(c), 500) for c in counts)])
    assert missed < 0.01 + 4.0 * (0.01 * 0.99 / 4000) ** 0.5


def test_the_row_says_its_rule_and_its_numbers() -> None:
    found = row("a", "0.2", near("norm", 0.25, 0.2, relative=0.01), witness=(above("norm", 0.25, 0.2),)).to_json()
    assert found["rule"] == "norm within 0.002 of 0.2. Refuted by: norm > 0.2" and found["verdict"] == "claim false"
    assert found["checks"] == [{"what": "norm", "value": 0.25, "rule": "within 0.002 of 0.2", "holds": False}]
    assert {"item", "printed", "computed", "verdict", "basis"} <= set(found)


def test_a_number_that_judges_nothing_is_found_out() -> None:
    assert_every_number_decides([row("a", "1", near("x", 1.0, 1.0, relative=0.1), below("y", 3.0, 2.0))])
    with pytest.raises(AssertionError, match="judges nothing"):
        assert_every_number_decides([row("a", "1", within("x", 1.0, float("-inf"), float("inf")))])


def sources() -> list[Path]:
    return [path for path in sorted(ROOM.rglob("*.py")) if path.name != "judgement.py"]


def test_no_row_is_given_a_literal_verdict() -> None:
    ours = set(VERDICTS) - {"undecided"}  # which certificates say too
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert node.value not in ours, f"{path.name}:{node.lineno} writes a verdict down"


def test_no_check_is_given_a_literal_value() -> None:
    found = 0
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in (*HELPERS, "Check"):
                found += 1
                names = [n for n in ast.walk(node.args[1]) if isinstance(n, ast.Name)]
                assert names, f"{path.name}:{node.lineno}: the value of the check is written down"
    assert found > 60


def test_a_print_far_beyond_a_few_runs_is_not_one_of_them() -> None:
    """Fewer runs than 1 / tail leave no rank outside it; a print three standard ranges away is none of them all the same."""
    runs = [0.12, 0.13, 0.14]
    for printed, unsure in ((0.13, True), (0.155, True), (0.4606, False), (0.01, False)):
        assert rank("share", runs, printed).undecided is unsure and not rank("share", runs, printed).holds
