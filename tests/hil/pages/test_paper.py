"""The plots of a report as files: one SVG and one PDF each, with the curves, labels and sizes of the page."""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure as Sheet

import hil
from hil.errors import HilError
from hil.measure.view import view_of
from hil.pages.html.figures import Bars, Figure, Histogram, Matrix, Scene, Section, Shape
from hil.pages.paper import draw, write_figures
from hil.pages.sections import sections_of
from tests.hil.cli.conftest import run_main


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    hil.run("dc-motor-hinf", seed=3, duration=4, log=path)
    return path


@pytest.mark.slow
def test_every_plot_of_a_report_is_written_as_svg_and_pdf(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_main("report", str(log), "-o", str(tmp_path / "page.html"), "--figures", str(tmp_path / "figures")) == 0
    names = sorted(path.name for path in (tmp_path / "figures").iterdir())
    run = hil.read_run(log)
    sections = sections_of(view_of(run))
    plots = [b for s in sections for b in s.blocks if isinstance(b, Figure | Bars | Histogram)]
    assert len(names) >= 2 * len(plots) > 8 and names[0].startswith("01-angle")
    assert f"written: {len(names)} figures" in capsys.readouterr().out
    for name in names:
        data = (tmp_path / "figures" / name).read_bytes()
        if name.endswith(".pdf"):
            assert data.startswith(b"%PDF")
        else:
            assert ElementTree.fromstring(data).get("width") == f"{85 / 25.4 * 72:.6f}pt"
    assert b"angle (rad)" in (tmp_path / "figures" / names[1]).read_bytes()


def test_the_curves_are_those_of_the_page(log: Path) -> None:
    for section in sections_of(view_of(hil.read_run(log))):
        for plot in section.blocks:
            if isinstance(plot, Figure):
                axis = Sheet().subplots()
                draw(plot, axis)
                for series, line in zip(plot.series, axis.lines):
                    assert np.array_equal(line.get_ydata(), series.y, equal_nan=True) and line.get_label() == series.label
                assert axis.get_xlabel() == f"{plot.x_label} ({plot.x_unit})"


def test_heat_maps_and_maps_are_plots_too(tmp_path: Path) -> None:
    chain = Matrix(title="Chain", rows=["0", "1"], columns=["0", "1"], values=[[0.1, None], [0.4, 0.6]],
                   expected=[[0.15, 0.85], [0.3, 0.7]])  # fmt: skip
    wall = Shape(points=[(0, 0), (2, 0), (2, 1)], label="wall", filled=True, colour=1)
    way = Scene(title="Way", shapes=(wall, Shape(points=[(0, 1), (1, 2)])), labels=((0.5, 0.5, "here"),))
    axes = [Sheet().subplots(), Sheet().subplots()]
    draw(chain, axes[0])
    draw(way, axes[1])
    assert axes[0].images[0].get_array().tolist() == [[0.1, None], [0.4, 0.6]]
    assert {text.get_text() for text in axes[0].texts} == {"0.100\n(0.150)", "–\n(0.850)", "0.400\n(0.300)", "0.600\n(0.700)"}
    assert len(axes[1].patches) == len(axes[1].lines) == 1 and axes[1].texts[0].get_text() == "here"
    files = write_figures([Section(title="s", blocks=(chain, way))], tmp_path)
    assert [path.name for path in files] == ["01-chain.svg", "01-chain.pdf", "02-way.svg", "02-way.pdf"]


def test_what_cannot_be_written_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HilError, match=r"--figures: .*cannot be written"):
        write_figures([], tmp_path / "file")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(HilError, match="matplotlib is not installed"):
        write_figures([], tmp_path / "figures")


@pytest.mark.parametrize(("x_log", "y_log"), [(True, False), (False, True)])
def test_a_histogram_on_paper_has_the_scales_of_the_page(x_log: bool, y_log: bool) -> None:
    axis = Sheet().subplots()
    plot = Histogram(title="n", edges=np.array([1.0, 10.0, 100.0]), counts=np.array([3.0, 4.0]), x_label="late", x_unit="us",
                     y_label="slots", x_log=x_log, y_log=y_log)  # fmt: skip
    draw(plot, axis)
    assert (axis.get_xscale(), axis.get_yscale()) == ("log" if x_log else "linear", "log" if y_log else "linear")
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("late (us)", "slots")
