"""A figure: its ratio, and what is said of its goal and its condition."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hil.errors import HilError
from tests.bench.catalogue import PARTS, take
from tests.bench.figure import NOT_JUDGED, AtMost, Figure, Found, Measure, Part, Row, in_both_forms, row_of
from tests.bench.page import page_of
from tests.bench.processes import HIL, spent
from tests.bench.run_parts import together
from tests.bench.shares import of_shares, ratio_interval

BOTH = Figure(name="slot", unit="us", peer="plain", goal=AtMost(ours=35.0), condition=AtMost(ratio=0.5))


def _about(rows: list[Row]) -> dict[str, object]:
    machine = {"cpus": 2, "cpu": "c" * 60, "memory_gb": 8.0, "system": "s" * 80, "python": "3.11.7", "load_before": 0.1}
    return {"machine": machine, "date": "2026-11-22", "quick": False, "seconds": {"start": 3.0}, "figures": rows}


def _verdicts(row: Row) -> tuple[str, str | None]:
    return row["goal_verdict"], row["condition_verdict"]


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (Found("slot", 35.0, 70.0), ("reached", "reached")),
        (Found("slot", 36.0, 70.0), ("missed", "missed")),
        (Found("slot", 36.0, 73.0), ("missed", "reached")),
        (Found("slot", 30.0, 70.0, unfinished=True), ("missed", "missed")),
        (Found("slot", 30.0, None), ("reached", "not measured: its peer is missing")),
        (Found("slot", float("nan"), 70.0), ("missed", "missed")),
    ],
)
def test_goal_and_condition_are_judged_each_by_its_own_number(found: Found, expected: tuple[str, str]) -> None:
    row = row_of("part", BOTH, found)
    assert _verdicts(row) == expected
    assert row["ratio"] == (None if found.peer is None or found.ours != found.ours else round(found.ours / found.peer, 4))


def test_what_was_not_measured_says_why_and_has_no_numbers() -> None:
    row = row_of("part", BOTH, None, "no disk")
    assert _verdicts(row) == ("not measured: no disk", "not measured: no disk")
    assert (row["ours"], row["peer"], row["ratio"], row["goal"]) == (None, None, None, "35 us")


def test_nothing_is_judged_where_something_smaller_was_measured() -> None:
    assert _verdicts(row_of("part", BOTH, Found("slot", 99.0, 9.0), quick=True)) == (NOT_JUDGED, NOT_JUDGED)


def test_a_peer_of_zero_has_no_ratio_but_a_verdict() -> None:
    late = Figure(name="late", unit="%", peer="can:hil", goal=AtMost(ratio=2.0))
    rows = [row_of("part", late, Found("late", ours, 0.0)) for ours in (0.0, 0.1)]
    assert [(row["ratio"], row["goal_verdict"]) for row in rows] == [(None, "reached"), (None, "missed")]


@pytest.mark.parametrize(
    ("ours", "peer", "verdict"),
    [(0, 31, "reached"), (0, 20, "undecided"), (2, 3, "undecided"), (0, 0, "undecided"), (20, 31, "missed")],
)
def test_few_events_decide_only_what_their_interval_leaves_no_doubt_of(ours: int, peer: int, verdict: str) -> None:
    late = Figure(name="late", unit="%", peer="before", condition=AtMost(ratio=0.1299))
    row = row_of("part", late, of_shares("late", (ours, 16_000), (peer, 16_000)))
    assert str(row["condition_verdict"]).partition(":")[0] == verdict
    assert "1 undecided" in page_of([_about([row])]) or verdict != "undecided"


@pytest.mark.slow
def test_the_interval_of_a_ratio_holds_the_true_one_as_often_as_it_says() -> None:
    draws = np.random.default_rng(14)
    held = [low <= 0.25 <= high for low, high in (
        ratio_interval((int(draws.binomial(8000, 0.0025)), 8000), (int(draws.binomial(4000, 0.01)), 4000)) for _ in range(2000)
    )]  # fmt: skip
    # 95 % of 2000: fewer than 1863 once in 10,000; of an interval of 90 %, as many as that three times in ten million.
    assert 1863 <= sum(held) <= 2000


def test_what_fails_costs_its_own_figures_and_no_others() -> None:
    first, second, third = (Figure(name=name, unit="s", peer="plain") for name in ("first", "second", "third"))

    def half(tell: object, quick: bool) -> Iterator[Found]:
        yield Found("first", 1.0, 2.0)
        raise HilError("no cyclictest\nhere")

    whole = Measure((third,), lambda tell, quick: [Found("third", 2.0, 4.0)])
    part = Part("part", "", 1.0, (Measure((first, second), half), whole))
    rows = {row["name"]: row for measure in part.measures for row in take(part, measure, quick=False)}
    assert [rows[name]["goal_verdict"] for name in ("first", "second", "third")] == [
        "measured", "not measured: no cyclictest here", "measured",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("interpreted", "compiled", "text", "below"),
    [
        (60.0, 30.0, "| 60 us | 0.857 | 30 us | 0.429 | reached: 35 us; condition holds", "70 us; missed; condition fails; comp"),
        (30.0, 60.0, "| 30 us | 0.429 | 60 us | 0.857 | missed: 35 us; condition fails", "70 us; reached; condition holds; comp"),
        (30.0, 20.0, "| 30 us | 0.429 | 20 us | 0.286 | reached: 35 us; condition holds: 0.5", "70 us; compiled, 70 us"),
        (60.0, None, "| 60 us | 0.857 | - | - | not measured: 35 us; condition not", "fails; compiled, not measured: no disk"),
    ],
)
def test_the_compiled_form_is_judged_where_it_was_measured(
    interpreted: float, compiled: float | None, text: str, below: str
) -> None:
    slow = row_of("part", BOTH, Found("slot", interpreted, 70.0))
    fast = row_of("part", BOTH, None if compiled is None else Found("slot", compiled, 70.0), "no disk")
    page = page_of([_about([in_both_forms(slow, fast)])])
    assert text in page and below in page
    assert f"Of 1 goals {int('| reached' in page)} are reached" in page


def test_what_shares_no_slots_shares_a_process() -> None:
    parts = {part.name: part for part in PARTS}
    assert together(parts["designs"]) == [list(range(len(parts["designs"].measures)))]
    assert [0] in together(parts["logs"]) and parts["logs"].measures[0].loops


def test_no_two_figures_share_a_name() -> None:
    names = [figure.name for part in PARTS for figure in part.figures]
    assert len(names) == len(set(names))


def test_no_line_of_a_page_is_wide_whatever_was_found() -> None:
    worst = [
        row_of(part.name, f, found, "it was interrupted " * 20)
        for part in PARTS for f in part.figures for found in (None, Found(f.name, 1234567.0, 1234567.0, "a long note " * 20))
    ]  # fmt: skip
    worst = [in_both_forms(row, row) for row in worst]
    text = page_of([_about(worst)])
    assert max(map(len, text.splitlines())) <= 130
    assert "| hil --help, CPU time | - | - | - | - | not measured |" in text


def test_a_command_that_fails_is_not_measured() -> None:
    with pytest.raises(HilError, match="exit status 2"):
        spent([*HIL, "run", "no-such-experiment"])
