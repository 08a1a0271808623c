"""A session as tables, as a figure for a paper, and as a cell of a notebook."""

from __future__ import annotations

import pickle
import re
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import hil
from design.monte_carlo.confidence import Interval
from hil.measure import Quantity
from hil.notebook import as_svg
from hil.sweeps.shown import paint_distributions, paint_points


@pytest.fixture(scope="module")
def session() -> hil.Session:
    return hil.run("dc-motor-hinf", seed=3, duration=4)


def test_tables_hold_every_record_with_its_time_and_unit(session: hil.Session) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed: pip install 'hilrig[notebook]'")
    frame = session.to_pandas()["/plant/measurement"]
    assert set(session.to_pandas()) == set(session.arrays) and frame.attrs["units"]["angle"] == "rad"
    assert np.array_equal(frame["angle"].to_numpy(), session.arrays["/plant/measurement"]["angle"])
    assert frame.index[-1] == pytest.approx(3.95)


def test_data_sets_hold_every_record_with_its_time_and_unit(session: hil.Session) -> None:
    pytest.importorskip("xarray", reason="xarray is not installed: pip install 'hilrig[notebook]'")
    found = session.to_xarray()["/plant/measurement"]["angle"]
    assert found.attrs["units"] == "rad" and float(found.sel(t_s=2.0)) == session.arrays["/plant/measurement"]["angle"][40]


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_a_library_that_is_not_installed_is_named_with_the_extra(
    session: hil.Session, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(hil.HilError, match=rf"{name} is not installed; pip install 'hilrig\[notebook\]'"):
        getattr(session, f"to_{name}")()


def test_a_figure_has_the_size_in_millimetres_and_shows_the_run(session: hil.Session, tmp_path: Path) -> None:
    import matplotlib

    drawn = session.plot(tmp_path / "step.svg", width_mm=100, height_mm=60)
    assert drawn.get_size_inches() * 25.4 == pytest.approx([100.0, 60.0])
    (outputs, inputs) = drawn.axes
    assert outputs.get_ylabel() == "angle (rad)" and inputs.get_xlabel() == "time (s)" and inputs.get_ylabel() == "voltage (V)"
    lines = {line.get_label(): line for axis in (outputs, inputs) for line in axis.lines}
    shown = {"reference": "/reference", "angle": "/plant/measurement", "voltage": "/actuator/applied"}
    for label, topic in shown.items():
        records = session.arrays[topic]
        assert np.array_equal(lines[label].get_ydata(), records["angle" if label == "reference" else label])
        assert np.array_equal(lines[label].get_xdata(), records["t_ns"] / 1e9)
    measured = lines["angle"]
    assert [text.get_text() for text in outputs.get_legend().texts] == ["reference", "angle"] and inputs.get_legend() is None
    assert measured.get_linewidth() == 1.0 < matplotlib.rcParamsDefault["lines.linewidth"], "in points, for a column in print"
    assert ElementTree.parse(tmp_path / "step.svg").getroot().get("width") == f"{100 / 25.4 * 72:.6f}pt"
    session.plot(tmp_path / "step.png", width_mm=100, height_mm=60)
    head = (tmp_path / "step.png").read_bytes()[16:24]
    assert (int.from_bytes(head[:4]), int.from_bytes(head[4:])) == (1181, 708), "300 dots per inch"
    session.plot(tmp_path / "step.pdf")
    assert (tmp_path / "step.pdf").read_bytes().startswith(b"%PDF")
    session.plot(tmp_path / "again.svg", width_mm=100, height_mm=60)
    assert (tmp_path / "again.svg").read_bytes() == (tmp_path / "step.svg").read_bytes(), "the same run, the same file"
    with matplotlib.rc_context({"axes.facecolor": "red", "lines.linewidth": 9.0}):
        session.plot(tmp_path / "mine.svg", width_mm=100, height_mm=60)
    assert (tmp_path / "mine.svg").read_bytes() == (tmp_path / "step.svg").read_bytes(), "whatever the user's own style is"


def test_several_inputs_stand_on_one_axis_with_their_names() -> None:
    outputs, inputs = hil.run("vtol-h2", duration=2).plot().axes
    assert outputs.get_ylabel() == "vertical_velocity (kn)" and len(outputs.lines) == 2
    names = ["collective_pitch", "longitudinal_cyclic_pitch"]
    assert [text.get_text() for text in inputs.get_legend().get_texts()] == names and inputs.get_ylabel() == "input"
    assert len({line.get_color() for line in (*inputs.lines, outputs.lines[1])}) == 3


@pytest.mark.parametrize(
    "path, size, said",
    [
        ("step.tiff", 85.0, "plot: "), (None, 1.0, "plot: "), ("nowhere/step.svg", 85.0, "cannot be written: No such file"),
        (3, 85.0, "plot: '3'; expected a name"), (None, "a", "plot: 'a' mm x "),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_reported(session: hil.Session, path: Any, size: Any, said: str) -> None:
    with pytest.raises(hil.HilError, match=said):
        session.plot(path, width_mm=size)


def test_a_cell_shows_numbers_with_units_and_the_plot(session: hil.Session, monkeypatch: pytest.MonkeyPatch) -> None:
    html = session._repr_html_()
    assert "squared tracking error (rad² s)" in html and f">{session.metrics['sse']:.5g}<" in html
    assert "<svg" in html and repr(session)[1:20] in html
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "<svg" not in session._repr_html_() and "rad² s" in session._repr_html_()


def test_a_dollar_sign_in_a_name_or_a_unit_begins_no_formula() -> None:
    unit = "$^{$"
    states = [["angle", "rad"], ["speed", "rad/s"]]
    plant = {"kind": "state-space", "A": [[0.0, 1.0], [0.0, -3.5]], "B": [[0.0], [171.0]], "C": [[1.0, 0.0]],
             "inputs": [["u", unit]], "outputs": [["y", unit]], "states": states}  # fmt: skip
    assert unit in hil.run("dc-motor-hinf", plant=plant, duration=1)._repr_html_()
    interval = Interval(1.0, 0.0, 2.0, 0.95, 3)
    values, of = {"late": np.arange(3.0)}, Quantity(name="late", title="late", unit=unit)
    for paint in (
        paint_distributions({"$_{$": values, "b": values}, of),
        paint_points(None, ["$_{$"], "$_$", {"$_{$": [interval], "b": [interval]}, of),
    ):
        assert {f"late ({unit})", "$_{$"} <= set(re.findall("<!-- (.*?) -->", as_svg(paint, 60.0)))


def test_a_misspelt_field_or_part_is_answered_with_the_nearest_one(session: hil.Session) -> None:
    records = session.arrays["/plant/measurement"]
    with pytest.raises(hil.HilError, match=r"no field of this topic is called 'angel'; did you mean 'angle'\? There are: t_ns, "):
        records["angel"]
    with pytest.raises(hil.HilError, match="did you mean 'angle'"):
        records[3:]["angel"]
    with pytest.raises(hil.HilError, match="did you mean 'angle'"):
        session.run.arrays["/plant/measurement"]["angel"]
    with pytest.raises(hil.HilError, match="did you mean '/plant/state'"):
        session.run.arrays["/plnt/state"]
    with pytest.raises(hil.HilError, match=r"no part of the summary is called 'metrcs'; did you mean 'metrics'\?"):
        session.summary["metrcs"]
    assert type(records["angle"]) is np.ndarray
    assert np.array_equal(records["angle"], session.run.arrays["/plant/measurement"]["angle"])
    assert records[["t_ns", "angle"]].dtype.names == ("t_ns", "angle") and float(records[-1]["angle"]) == records["angle"][-1]
    assert pickle.loads(pickle.dumps(records))["angle"].tolist() == records["angle"].tolist()
