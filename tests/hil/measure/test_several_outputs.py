"""Outputs of several units: each has its own numbers, with their units, wherever a run or many are shown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import hil
from hil.cli.page_text import print_summary
from hil.measure.view import view_of
from hil.pages.run_page import logged_run, render_report

CART = """
name = "cart"
period = "50 ms"
duration = "2 s"
controller = { kind = "local", gain = [[-1, -1]] }
reference = [{ at = "0.5 s", value = [1.0, 0.0] }]
network = { sc = { law = { kind = "constant", age = 0 } }, ca = { law = { kind = "constant", age = 0 } } }
[plant]
kind = "state-space"
A = [[0, 1], [0, -1]]
B = [[0], [1]]
C = [[1, 0], [0, 1]]
inputs = [["force", "N"]]
outputs = [["place", "m"], ["speed", "m/s"]]
"""


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("cart") / "cart.toml"
    file.write_text(CART)
    return file


@pytest.fixture(scope="module")
def session(cart: Path) -> hil.Session:
    return hil.run(cart)


def test_the_summary_gives_each_number_its_unit_and_none_that_outputs_share_no_unit_for(
    session: hil.Session, capsys: pytest.CaptureFixture[str]
) -> None:
    print_summary(session.summary)
    said = " ".join(capsys.readouterr().out.split())
    place = session.metrics["outputs"]["place"]
    assert f"place squared tracking error {place['sse']:.5g} m² s" in said and "(m/s)² s" in said
    assert "squared tracking error -" not in said and "overshoot - " not in said
    assert "squared tracking error of speed ((m/s)² s)" in session._repr_html_()
    page = render_report(view_of(session.run))
    assert "Steady-state error</div>" not in page and "Largest input</div>" in page


def test_the_page_of_a_folder_has_a_number_of_each_output(session: hil.Session) -> None:
    row = logged_run("cart.mcap", "cart.html", view_of(session.run), drawn=False)
    assert row.numbers["squared tracking error of place (m² s)"] == session.metrics["outputs"]["place"]["sse"]
    assert all(value is None or isinstance(value, float) for value in row.numbers.values())


def test_a_figure_for_a_paper_has_room_for_every_output(session: hil.Session) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'hilrig[notebook]'")
    sheet = session.plot()
    sheet.draw_without_rendering()
    plots = [axis.get_window_extent() for axis in sheet.axes]
    names = [axis.yaxis.label.get_window_extent() for axis in sheet.axes]
    assert all(name.height < 1.2 * plot.height for name, plot in zip(names, plots))
    assert [axis.get_legend() is not None for axis in sheet.axes] == [True, False, False]


def test_a_comparison_and_a_grid_say_what_they_can_of_each_output(cart: Path) -> None:
    both = hil.compare(cart, hil.load_experiment(cart, name="second"), runs=2, jobs=1)
    assert "is not summed over outputs of several units" in repr(both)
    grid = hil.sweep(cart, grid={"controller.gain": [[[-1, -1]], [[-2, -1]]]}, runs=2, jobs=1)
    assert grid.answer("sse.place").startswith("best point: ")
    assert grid.answer("sse") == "squared tracking error: no point is best; at each safety stopped a run, or a run has no number"
    assert "squared tracking error of place" in repr(hil.sweep(cart, runs=2, jobs=1)), "not one that no run has"
    assert "squared tracking error of place" in grid._repr_html_()


def test_inputs_of_several_units_have_no_largest_one(cart: Path) -> None:
    two = {"plant.inputs": [["force", "N"], ["heat", "W"]], "plant.B": [[1, 0], [0, 1]], "controller.gain": [[-1, 0], [0, -1]]}
    asked: dict[str, Any] = {**two, "duration": "0.5 s", "report.measures": ["tracking", "cost"]}
    alone, many = hil.run(cart, **asked), hil.sweep(cart, runs=2, jobs=1, **asked)
    assert not {"max_abs_u", "peak_input"} & ({*alone.metrics} | {*many.values}) and "cost" in alone.metrics
    assert alone.metrics["cost"] == many.values["cost"][0]
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'hilrig[notebook]'")
    legend = alone.plot().axes[-1].get_legend()
    assert legend is not None and [each.get_text() for each in legend.get_texts()] == ["force (N)", "heat (W)"]
