"""Chapters 2 and 4: gains, settling times and figures, each from what is known of it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from design.as_printed import chapter2_process, chapter3_process, chapter4_process
from hil.thesis.chapter2_feasibility import FEASIBILITY, feasibility, markov_approximation, mean_sojourns
from hil.thesis.chapter2_runs import IN_THE_LOOP, comparison, settling_time
from hil.thesis.chapter2_runs import settled_on_the_rig as settled
from hil.thesis.chapter4_simulations import GAMMA, RECOMPUTED, detection_fault, lifetimes, recomputed, simulate
from hil.thesis.statements import judge
from tests.hil.thesis.judging import assert_every_number_decides


def _quiet(text: str, done: int = 0, total: int = 0, /) -> None:
    pass


def test_more_sections_are_feasible_where_fewer_are_not() -> None:
    rows = judge(FEASIBILITY, feasibility(_quiet))
    verdicts = {row.item: row.verdict for row in rows}
    assert [row.verdict for row in rows if row.item.startswith("M = 4 yields")] == ["reproduced", "reproduced"]
    assert verdicts["(2.27): the gains of Corollary 2.2, M = 2"] == "not reproduced"  # it does not determine them
    assert verdicts["computation time of the gains of Corollary 2.2, M = 2"] == "undecided"  # that PC is not at hand
    assert_every_number_decides(rows)


def test_settling_begins_after_the_last_sample_outside_the_band() -> None:
    time_s = 0.5 * np.arange(6)
    x = np.array([100.0, 1.0, 2.0, 1.0, 0.0, 0.0])[:, None] * [0.6, 0.8]
    assert settling_time(time_s, x) == 1.5
    assert settling_time(time_s, 0 * x) == 0.0
    assert settling_time(time_s, np.ones((6, 2))) == 3.0  # never: the end of the run


def test_the_gains_of_the_reference_run_and_settle_later() -> None:
    published, reference = (settled(name, (0, 1)) for name in ("smjls-robust-published", "smjls-robust-reference"))
    assert (published < reference).all() and (published < 5.0).all()


@pytest.mark.parametrize(("slower", "verdict"), [(7.0, "reproduced"), (0.0, "not reproduced"), (-7.0, "not reproduced")])
def test_the_rows_follow_the_times(slower: float, verdict: str) -> None:
    times = 3.0 + np.random.default_rng(0).random(40)
    rows = judge(IN_THE_LOOP, comparison({"published": times, "ours": times[::-1], "reference": times + slower}))
    assert [row.verdict for row in rows] == [verdict] * 2
    assert_every_number_decides(rows)


def test_the_mean_sojourn_is_that_of_the_survival_function() -> None:
    """Of the ramp (2.26): the integral of exp(-H) with H' = min(max(h, 0.1), 4.6)."""
    h = np.linspace(0.0, 20.0, 200_001)
    rate = np.clip(h, 0.1, 4.6)
    survival = np.exp(-np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(h))]))
    assert mean_sojourns(chapter2_process()) == pytest.approx([float(np.trapezoid(survival, h))] * 2, rel=1e-4)
    found = markov_approximation(chapter2_process())
    assert mean_sojourns(found) == pytest.approx(mean_sojourns(chapter2_process()), rel=1e-4)
    with pytest.raises(ValueError, match="3 modes"):
        markov_approximation(chapter3_process())


def test_gains_of_the_corollaries_are_those_of_their_sections(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under one bound, in the place of all three, and by 10 runs."""
    for name, value in (("BOUNDS", (50.0,)), ("RUNS", 10), ("simulate", partial(simulate, runs=10))):
        monkeypatch.setattr(f"hil.thesis.chapter4_simulations.{name}", value)
    found = recomputed(_quiet)
    rows = judge(RECOMPUTED, {name: numbers if name == "size" else 3 * numbers for name, numbers in found.items()})
    assert [row.verdict for row in rows] == ["not reproduced", "not reproduced", "reproduced", "not reproduced"]
    assert found["ratios"][0] == pytest.approx([0.029, 0.029], rel=0.1) and found["levels"][0][0] < GAMMA


def test_figures_4_1_and_4_2_show_the_lifetimes_of_components_that_fail_once_a_second() -> None:
    density, rate = lifetimes().panels
    h = np.linspace(0.0, 5.0, 400)
    e = np.exp(-h)
    laws = [(n * e * (1.0 - e) ** (n - 1), 1.0 - (1.0 - e) ** n) for n in (1, 2, 3)] + [(h * e, (1.0 + h) * e)]
    assert [each.label for each in rate.series] == ["one component", "one of two", "one of three", "one and a cold spare"]
    for (own, left), drawn, falls in zip(laws, density.series, rate.series, strict=True):
        np.testing.assert_array_equal(drawn.x, h)
        np.testing.assert_allclose(drawn.y, own, atol=1e-12)
        np.testing.assert_allclose(falls.y, own / left, atol=1e-12)


def test_figure_4_3_shows_19_s_of_the_fault_and_its_detection() -> None:
    (panel,) = detection_fault(chapter4_process(failure_restarts_detection_clock=False)).panels
    assert [each.label for each in panel.series] == ["eta (fault)", "r (detection)"] and panel.integer_y
    for path in panel.series:
        assert path.style == "step" and path.x[0] == 0.0 and path.x[-1] == 19.0 and (np.diff(path.x) >= 0.0).all()
        assert {*path.y} == {1.0, 2.0} and path.y[0] == 1.0 and path.y[-1] == path.y[-2]
