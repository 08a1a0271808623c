"""The verdict of a comparison: first in words, with the number and the interval that decide it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hil
from hil.report.compare import compare_page
from hil.sweeps.comparison import relative


@pytest.fixture(scope="module")
def both() -> hil.Comparison:
    return hil.compare("dc-motor-ours-h2", "dc-motor-smith", runs=30, jobs=1, duration=10)


def test_it_says_which_is_better_by_how_much(both: hil.Comparison) -> None:
    told = both.verdict("dc-motor-smith")
    a, b = (both.values[name]["sse"] for name in both.values)
    assert b.mean() > a.mean() and told.startswith("dc-motor-smith is worse than dc-motor-ours-h2: sse +")
    assert f"sse {100 * (b.mean() / a.mean() - 1):+.1f} %, 95 % interval +" in told and told.endswith("30 runs")
    turned = replace(both, values=dict(reversed(both.values.items())))
    assert turned.verdict("dc-motor-ours-h2").startswith("dc-motor-ours-h2 is better than dc-motor-smith: sse -")


def test_the_same_experiment_shows_no_difference_and_stopped_runs_are_undecided(both: hil.Comparison) -> None:
    first = both.values["dc-motor-ours-h2"]
    same = replace(both, values={"a": first, "b": dict(first) | {"sse": first["sse"][::-1].copy()}})
    assert "no difference is shown" in same.verdict("b")
    stopped = replace(both, values={"a": first, "b": dict(first) | {"stopped": np.eye(30)[0]}})
    assert stopped.verdict("b") == "b against a: undecided; safety stopped runs (of 30): a in 0, b in 1"


def test_the_interval_of_a_ratio_holds_it_as_often_as_it_says() -> None:
    """2000 samples of 40 pairs: the share of intervals with the truth in them is 95 %, but for the normal approximation."""
    rng = np.random.default_rng(1)
    a = rng.normal(10.0, 2.0, (2000, 40))
    b = 0.9 * a + rng.normal(0.0, 0.5, (2000, 40))
    found = [relative(x, y) for x, y in zip(a, b)]
    held = np.mean([i is not None and i.low <= -0.1 <= i.high for i in found])
    assert 0.92 < held < 0.965


def test_the_page_begins_with_the_answer(both: hil.Comparison) -> None:
    page = compare_page(both)
    assert "dc-motor-smith is worse than dc-motor-ours-h2" in page
    assert page.index("is worse than") < page.index("share of runs at or below")
    assert page.index("mean of") < page.index("share of runs at or below")
