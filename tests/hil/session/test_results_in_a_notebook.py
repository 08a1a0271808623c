"""Results of many runs, of a design and of a chapter: one line, answer, table, plot, and pandas."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import hil
from hil.api.questions import Laws
from hil.notebook import SIDE, Result
from hil.pages import Figure, Series
from hil.thesis import Plot, Reproduction

SHORT = {"runs": 4, "jobs": 1, "duration": 3}


@pytest.fixture(scope="module")
def sweep() -> hil.Sweep:
    found = hil.sweep("dc-motor-hinf", **SHORT)
    assert isinstance(found, hil.Sweep)
    return found


@pytest.fixture(scope="module")
def over_gain() -> hil.ParameterSweep:
    found = hil.sweep("dc-motor-hinf", grid={"plant.gain": [150, 170], "period": ["25 ms", "50 ms"]}, **SHORT)
    assert isinstance(found, hil.ParameterSweep)
    return found


@pytest.fixture(scope="module")
def comparison() -> hil.Comparison:
    return hil.compare("dc-motor-hinf", "dc-motor-h2", **SHORT)


@pytest.fixture(scope="module")
def design() -> hil.DesignResult:
    return hil.design("dc-motor", information="constant", starts=1)


@pytest.fixture(scope="module")
def laws() -> Laws:
    return hil.laws("dc-motor-hinf")


@pytest.fixture(scope="module")
def chapter() -> Reproduction:
    panels = tuple(Figure(title=t, series=(Series(label="y", x=np.arange(3.0), y=np.arange(3.0)),)) for t in ("a", "b"))
    plots = (Plot(title="Figure 6.8", panels=panels), Plot(title="Figure 6.9", panels=panels[:1]))
    return Reproduction(title="Chapter 6", rows=(), figures=plots)


def well_formed(html: str) -> ElementTree.Element:
    svg = html.find("<svg")
    return ElementTree.fromstring(html[:svg] + "</div>" if svg >= 0 else html)


@pytest.mark.parametrize("name", ["sweep", "over_gain", "comparison", "design"])
def test_a_result_is_one_short_line_and_a_cell_with_answer_table_and_plot(name: str, request: pytest.FixtureRequest) -> None:
    found = request.getfixturevalue(name)
    line = repr(found)
    assert "\n" not in line and len(line) < 300 and line[0] == "<" and line[-1] == ">" and "array(" not in line
    html = found._repr_html_()
    tree = well_formed(html)
    assert tree.find("p/b") is not None and len(tree.findall(".//tbody/tr")) >= 3 and "<svg" in html


def test_points_are_not_compared_where_no_value_is_better(over_gain: hil.ParameterSweep) -> None:
    of = next(quantity.name for quantity in over_gain.quantities if not quantity.better)
    assert over_gain.best(of) is None and f"{of}: no measure states which value is better" in over_gain.answer(of)
    assert len(over_gain.plot(quantity=of).axes) >= 1


@pytest.mark.parametrize("name", ["sweep", "over_gain", "comparison", "design", "laws", "chapter"])
def test_a_plot_is_shown_by_its_cell_and_written_to_its_file(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    drawn = request.getfixturevalue(name).plot(tmp_path / "a.svg")
    assert ElementTree.fromstring(drawn._repr_svg_()).tag.endswith("svg") and (tmp_path / "a.svg").stat().st_size > 1000


def test_laws_are_a_line_a_table_and_a_frame_of_ages(laws: Laws) -> None:
    assert repr(laws).startswith("<Laws of dc-motor-hinf: sc markov with mean age 0.396 slots, ca markov")
    assert len(well_formed(laws._repr_html_()).findall(".//tbody/tr")) == 2
    frame = laws.to_pandas()
    assert frame.groupby("way")["share"].sum().tolist() == pytest.approx([1.0, 1.0])
    with pytest.raises(hil.HilError, match="no way is called 'sca'; did you mean 'sc'"):
        laws["sca"]
    assert repr(pickle.loads(pickle.dumps(laws))) == repr(laws)


def test_a_chapter_draws_the_figure_that_is_named(chapter: Reproduction) -> None:
    assert [len(chapter.plot(figure=name).axes) for name in (None, "Figure 6.9")] == [2, 1]
    assert "<svg" in chapter._repr_html_()
    with pytest.raises(hil.HilError, match=r"no figure is called 'Figure 6.7'"):
        chapter.plot(figure="Figure 6.7")
    with pytest.raises(hil.HilError, match="has no figures"):
        Reproduction(title="Chapter 3", rows=()).plot()


def test_a_cell_needs_no_matplotlib(sweep: hil.Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib", None)
    html = sweep._repr_html_()
    assert "<table>" in html and "<svg" not in html
    assert "squared tracking error" in html and not re.search(r"\bsse\b|steady_state_error|max_abs_u", html), "titles, no keys"
    with pytest.raises(hil.HilError, match=r"plot: matplotlib is not installed; pip install 'hilrig\[notebook\]'"):
        sweep.plot()


def test_tables_of_pandas_hold_every_run_with_its_units(
    sweep: hil.Sweep, over_gain: hil.ParameterSweep, comparison: hil.Comparison, design: hil.DesignResult
) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed: pip install 'hilrig[notebook]'")
    frame = sweep.to_pandas()
    assert frame.shape[0] == 4 and frame.attrs["units"]["sse"] == "rad² s" and frame["seed"].tolist() == [0, 1, 2, 3]
    assert np.array_equal(frame["sse"], sweep.values["sse"])
    points = over_gain.to_pandas()
    assert points.shape[0] == 16 and set(points["plant.gain"]) == {"150", "170"} and set(points["period"]) == {"25 ms", "50 ms"}
    chosen = points[(points["plant.gain"] == "170") & (points["period"] == "25 ms")]
    assert np.array_equal(chosen["sse"], over_gain.columns[2]["sse"])
    both = comparison.to_pandas()
    assert list(both["experiment"].unique()) == ["dc-motor-hinf", "dc-motor-h2"] and both.shape[0] == 8
    assert np.array_equal(design.to_pandas()["gain"], design.gains.ravel()) and design.plot().axes[0].get_ylabel() == "gain"


def test_the_best_point_and_its_paired_differences(over_gain: hil.ParameterSweep) -> None:
    means = [columns["sse"].mean() for columns in over_gain.columns]
    best = over_gain.best("sse")
    assert best == int(np.argmin(means)) and over_gain.answer("sse").startswith("best point: plant.gain=")
    other = (best + 1) % 4
    gap = over_gain.difference(other, best, "sse")
    assert gap.value == pytest.approx(means[other] - means[best]) and gap.n == 4


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"grid": {"plant.gain": 150}}, r"plant.gain: 150; expected a list of values, such as \[150, 170\]"),
        ({"grid": {}}, "no parameter is named"),
        ({"grid": {"plant.gian": [1, 2]}}, "did you mean 'gain'"),
        ({"range": {"plant.gain": (100, 200)}}, "range=.* and points=N belong together"),
        ({"range": {"plant.gain": (100, 200)}, "points": 0}, "points: 0; expected 1 to"),
        ({"range": {"plant.gain": (100, 150, 200)}, "points": 3}, "3 values; expected the lowest and the highest"),
        ({"range": {"plant.gain": (200, 100)}, "points": 3}, "the lower first"),
        ({"grid": {"plant.gain": [1]}, "range": {"plant.gain": (1, 2)}, "points": 2}, "one of them"),
    ],
)
def test_points_that_are_none_are_refused(asked: dict[str, object], said: str) -> None:
    with pytest.raises(hil.HilError, match=said):
        hil.sweep("dc-motor-hinf", runs=2, jobs=1, duration=1, **asked)  # type: ignore[arg-type]


def test_a_grid_takes_objects_and_ranges_take_points() -> None:
    found = hil.sweep("dc-motor-hinf", range={"plant.gain": (150, 170)}, points=2, runs=2, jobs=1, duration=1, controller=-0.2)
    assert isinstance(found, hil.ParameterSweep) and len(found.columns) == 2
    assert "point (plant.gain)" in found.plot().axes[0].get_xlabel() or found.plot().axes[0].get_xlabel() == "plant.gain"


def test_a_quantity_that_is_not_there_is_answered_with_those_that_are(sweep: hil.Sweep, comparison: hil.Comparison) -> None:
    session = hil.run("dc-motor-hinf", duration=1)
    for ask in (
        lambda: session.metrics["settling_tme_s"], lambda: sweep.values["settling_tme_s"],
        lambda: sweep.plot(quantity="settling_tme_s"),
        lambda: comparison.difference("dc-motor-h2", "settling_tme_s"),
    ):  # fmt: skip
        with pytest.raises(KeyError, match=r"did you mean 'settling_time_s'\? There are: ") as caught:
            ask()
        assert isinstance(caught.value, hil.HilError)
    with pytest.raises(hil.HilError, match="no experiment is called 'dc-motor-h3'; did you mean"):
        comparison.difference("dc-motor-h3", "sse")


def test_a_cell_of_a_run_has_the_title_and_the_unit_of_the_page() -> None:
    html = hil.run("dc-motor-hinf", seed=3, duration=10)._repr_html_()
    assert "squared error after 5 s" in html and "sse_after_5s<" not in html and "overshoot (%)" in html


def test_pages_of_many_runs_are_written_once(
    comparison: hil.Comparison, sweep: hil.Sweep, over_gain: hil.ParameterSweep, tmp_path: Path
) -> None:
    for source in (comparison, sweep, over_gain):
        page = tmp_path / f"{type(source).__name__}.html"
        assert hil.report(source, output=page) == (page,) and page.read_text().lower().startswith("<!doctype html")
        hil.report(source, output=page)  # a page is replaced, another file only where it is asked for
        page.write_text("mine")
        with pytest.raises(hil.HilError, match="force=True"):
            hil.report(source, output=page)
        assert page.read_text() == "mine" and hil.report(source, output=page, force=True) == (page,)
    with pytest.raises(hil.HilError, match=r"expected output='page.html'"):
        hil.report(comparison)


def test_a_log_is_replaced_only_when_asked(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    hil.run("dc-motor-hinf", duration=1, log=log)
    before = log.read_bytes()
    with pytest.raises(hil.HilError, match=r"exists already; choose another log=\.\.\., or add force=True"):
        hil.run("dc-motor-hinf", duration=1, seed=1, log=log)
    assert log.read_bytes() == before
    hil.run("dc-motor-hinf", duration=1, seed=1, log=log, force=True)
    assert log.read_bytes() != before


def test_laws_and_designs_are_asked_without_a_run(design: hil.DesignResult, tmp_path: Path) -> None:
    assert set(hil.laws("dc-motor-hinf")) == {"sc", "ca"} and hil.laws("dc-motor-hinf")["ca"].stationary
    path = design.save(tmp_path / "gains.json")
    with pytest.raises(hil.HilError, match="force=True"):
        design.save(path)
    session = hil.run("dc-motor-hinf", duration=1, controller={"kind": "designed", "file": str(path)})
    assert session.summary["certificate"] and np.isfinite(session.metrics["sse"])


def test_a_chapter_that_is_none_is_answered_with_those_that_are() -> None:
    with pytest.raises(hil.HilError, match=r"no chapter is called 'ch9'.*ch7"):
        hil.reproduce("ch9")


def test_words_of_a_cell_stand_at_the_left_and_numbers_at_the_right() -> None:
    cell = Result(line="a < b", columns=("name", "count", "mean"), rows=[("x", 3, None), ("<y>", 4, 1.0 / 3.0)]).html()
    table = cell[cell.index("<table>") :]
    sides = {side: SIDE.format(side=side) for side in ("left", "right")}
    heads = [f'<th style="{sides[side]}">{head}</th>' for side, head in (("left", "name"), ("right", "count"), ("right", "mean"))]
    kept = [
        f'<td style="{sides[side]};white-space:nowrap">{text}</td>'
        for side, text in (("left", "&lt;y&gt;"), ("right", "4"), ("right", "0.33333"), ("right", "-"))
    ]
    assert "".join(heads) in table and "".join(kept[:3]) in table and kept[3] in table
    assert "<p>a &lt; b</p>" in cell and "<table>" not in Result(line="a").html()


def test_a_number_stays_on_one_line_and_a_sentence_folds() -> None:
    cell = Result(line="", columns=("mean", "rule"), rows=[(-1.8489e-08, "a sentence that is longer than its column")]).html()
    assert 'white-space:nowrap">-1.8489e-08<' in cell and cell.count("nowrap") == 1
