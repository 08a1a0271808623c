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
from hil.report.html.figures import Bars, Figure, Histogram
from hil.report.paper import draw, write_figures
from hil.report.run.run_page import run_sections
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
    session = hil.run("dc-motor-hinf", seed=3, duration=4)
    sections = run_sections(view_of(run), session.summary, {})
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
    session = hil.run("dc-motor-hinf", seed=3, duration=4)
    for section in run_sections(view_of(hil.read_run(log)), session.summary, {}):
        for plot in section.blocks:
            if isinstance(plot, Figure):
                axis = Sheet().subplots()
                draw(plot, axis)
                for series, line in zip(plot.series, axis.lines):
                    assert np.array_equal(line.get_ydata(), series.y, equal_nan=True) and line.get_label() == series.label
                assert axis.get_xlabel() == f"{plot.x_label} ({plot.x_unit})"


def test_what_cannot_be_written_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HilError, match=r"--figures: .*cannot be written"):
        write_figures([], tmp_path / "file")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(HilError, match="matplotlib is not installed"):
        write_figures([], tmp_path / "figures")
