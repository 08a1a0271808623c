"""The verdict of a comparison, first in words, with the number and the interval that decide it; and the axis of its values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure as Sheet
from scipy.stats import binom

import hil
from hil.measure import Quantity
from hil.pages.many_runs import compare_page
from hil.sweeps import statistics
from hil.sweeps.shown import CRUSHED, DECADES, Axis, axis_for, paint_distributions


@pytest.fixture(scope="module")
def both() -> hil.Comparison:
    return hil.compare("dc-motor-ours-h2", "dc-motor-smith", runs=30, jobs=1, duration=10)


def test_it_says_which_is_better_by_how_much(both: hil.Comparison) -> None:
    reported = both.verdict("dc-motor-smith")
    a, b = (both.values[name]["sse"] for name in both.values)
    assert b.mean() > a.mean() and reported.startswith("dc-motor-smith is worse than dc-motor-ours-h2: squared tracking error +")
    assert f"error {100 * (b.mean() / a.mean() - 1):+.1f} %, 95 % interval +" in reported and reported.endswith("30 runs")
    turned = replace(both, values=dict(reversed(both.values.items())))
    said = turned.verdict("dc-motor-ours-h2")
    assert said.startswith("dc-motor-ours-h2 is better than dc-motor-smith: squared tracking error -")


def test_the_same_experiment_shows_no_difference(both: hil.Comparison) -> None:
    first = both.values["dc-motor-ours-h2"]
    same = replace(both, values={"a": first, "b": dict(first) | {"sse": first["sse"][::-1].copy()}})
    assert "no difference is shown" in same.verdict("b")


@pytest.mark.parametrize(
    ("own", "other", "said"),
    [
        (30, 0, "b is worse: safety stopped 30 of its 30 runs, none of a"),
        (0, 30, "b is better: safety stopped none of its 30 runs, 30 of a"),
        (6, 0, "b is worse: safety stopped 6 of its 30 runs, none of a"),
        (1, 0, "b against a: undecided; safety stopped 1 of its 30 runs, none of a (as many by chance: p = 1)"),
        (30, 30, "b against a: undecided; safety stopped 30 of its 30 runs, 30 of a (as many by chance: p = 1)"),
    ],
)
def test_whom_safety_stops_is_the_answer(both: hil.Comparison, own: int, other: int, said: str) -> None:
    first = both.values["dc-motor-ours-h2"]
    stopped = {name: dict(first) | {"stopped": (np.arange(30) < n).astype(float)} for name, n in (("a", other), ("b", own))}
    found = replace(both, values=stopped)
    assert found.verdict("b") == said
    assert "means are over the shorter runs too" in found._repr_html_()
    assert "Means are over the shorter runs too" in compare_page(found)


@pytest.mark.parametrize("worst", [np.inf, np.nan])
def test_a_mean_over_those_that_came_through_is_no_verdict(both: hil.Comparison, worst: float) -> None:
    """Who diverges in the runs that the other finds hard has the smaller mean over the rest."""
    first = both.values["dc-motor-ours-h2"]
    hard = first["sse"] > np.quantile(first["sse"], 0.7)
    values = {"a": first, "b": dict(first) | {"sse": np.where(hard, worst, 0.99 * first["sse"])}}
    said = replace(both, values=values).verdict("b")
    assert said == (
        "b against a: undecided; squared tracking error is a number in 21 of its 30 runs and in 30 of a, not in the same ones"
    )
    same = {"a": dict(first) | {"sse": np.where(hard, np.nan, first["sse"])}, "b": values["b"]}
    assert replace(both, values=same).verdict("b").startswith("b is better than a: ")


def test_of_many_equal_experiments_hardly_one_is_called_better_or_worse() -> None:
    quantity, rng = Quantity(name="lost", title="packets lost", better="lower"), np.random.default_rng(5)
    wrong, stops = 0, 0
    for _ in range(100):
        values = {name: {"stopped": np.zeros(20), "lost": rng.normal(9.0, 1.0, 20)} for name in "abcdefghijk"}
        found = hil.Comparison(runs=20, values=values, quantities=(quantity,))
        said = [found.verdict(name) for name in "bcdefghijk"]
        wrong += any(" than a: " in each for each in said)
        for columns in values.values():
            columns["stopped"] = (rng.random(20) < 0.5).astype(float)
        stops += any("undecided" not in found.verdict(name) for name in "bcdefghijk")
    assert wrong < 10 and stops < 10, "one by one 24 and 14"
    assert ", 99.5 % interval " in said[0] and said[0].endswith("20 runs (95 % for all 10 together)")


def test_equal_differences_of_a_few_runs_show_nothing() -> None:
    quantity = Quantity(name="lost", title="packets lost", better="lower")
    few = "b against a: undecided; packets lost differs by the same +1 in all 5 runs, and 6 are needed to show that"
    enough = "b is worse than a: packets lost +1 in every pair (equal differences: no interval), 6 runs"
    for n, said in ((5, few), (6, enough)):
        values = {name: {"stopped": np.zeros(n), "lost": np.full(n, lost)} for name, lost in (("a", 1.0), ("b", 2.0))}
        assert hil.Comparison(runs=n, values=values, quantities=(quantity,)).verdict("b") == said


def test_two_equal_laws_are_seldom_called_different() -> None:
    """5 % of verdicts at n = 2, 3, 5, 10: a binomial bound of 1e-4 over 600 comparisons each."""
    quantity = Quantity(name="sse", title="squared error", unit="rad² s", better="lower")
    rng = np.random.default_rng(12)
    for n in (2, 3, 5, 10):
        false = 0
        for _ in range(600):
            values = {name: {"stopped": np.zeros(n), "sse": rng.normal(12.0, 0.5, n)} for name in "ab"}
            said = hil.Comparison(runs=n, values=values, quantities=(quantity,)).verdict("b")
            false += "no difference is shown" not in said
        assert false <= int(binom.ppf(1.0 - 1e-4, 600, 0.05))


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_an_axis_follows_its_values_whatever_their_unit(unit: float) -> None:
    def axis(*groups: list[float]) -> Axis:
        return axis_for([unit * np.array(group) for group in groups])

    assert axis([11.0, 12.0], [350.0]) == Axis(log=True)
    assert axis([1.0, 1.0], [float("nan")], [CRUSHED]) == axis() == axis([]) == axis([0.0, 0.0, 9e9]) == Axis()
    assert axis([1.0, 1.0], [1.01 * CRUSHED]) == Axis(log=True)
    assert axis([0.0, 1.0, 1.0], [1.01 * CRUSHED]).asinh == pytest.approx(unit)
    assert axis([0.0, 1.0, 1.0], [2.0 * 10.0**9]).asinh == pytest.approx(2e9 * unit / DECADES)


def test_statistics_are_those_of_the_runs_that_have_a_number() -> None:
    found = statistics(np.array([1.0, np.nan, 3.0, np.inf]))
    assert (found["n"], found["mean"], found["sd"], found["se"]) == (2, 2.0, pytest.approx(2.0**0.5), pytest.approx(1.0))
    assert found["percentiles"] == pytest.approx({str(p): 1.0 + p / 50.0 for p in (1, 5, 25, 50, 75, 95, 99)})
    one = statistics(np.array([5.0, np.nan]))
    assert (one["n"], one["mean"], one["sd"], one["se"]) == (1, 5.0, None, None)
    assert statistics(np.full(7, 0.1))["sd"] == 0.0 < np.full(7, 0.1).std()
    none = statistics(np.array([np.nan]))
    assert none == {"n": 0, "mean": None, "sd": None, "se": None, "percentiles": {}}


def test_every_curve_of_a_figure_for_a_paper_goes_from_0_to_1_over_the_values_of_all() -> None:
    sheet, cost = Sheet(), Quantity(name="cost", title="cost", unit="")
    found = {"a": [2.0, 1.0, np.nan], "none": [np.nan], "b": [3.0, 3.0]}
    paint_distributions({name: {"cost": np.array(values)} for name, values in found.items()}, cost)(sheet)
    curves = {line.get_label(): np.asarray(line.get_xydata()).tolist() for line in sheet.axes[0].get_lines()}
    assert curves == {
        "a": [[1.0, 0.0], [1.0, 0.5], [2.0, 1.0], [3.0, 1.0]],
        "b": [[1.0, 0.0], [1.0, 0.0], [3.0, 1.0]],
    }
