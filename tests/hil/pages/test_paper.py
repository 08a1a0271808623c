"""The plots of a report as files: one SVG and one PDF each, of the size asked for. What they draw: `test_whole_pages`."""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from msgspec.structs import replace

import hil
from hil.errors import HilError
from hil.pages import Figure, Section, Series, Text
from hil.pages.paper import write_figures
from tests.hil.cli.conftest import run_main
from tests.hil.pages.whole_pages import FIGURES


@pytest.mark.slow
def test_every_plot_of_a_report_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hil.run("dc-motor-hinf", duration=4, log=tmp_path / "run.mcap")
    assert run_main("report", str(tmp_path / "run.mcap"), "--figures", str(tmp_path / "figures")) == 0
    names = sorted(path.name for path in (tmp_path / "figures").iterdir())
    assert len(names) > 8 and names[0].startswith("01-angle")
    assert f"written: {len(names) // 2} figures, as SVG and PDF" in capsys.readouterr().out
    assert b"angle (rad)" in (tmp_path / "figures" / names[1]).read_bytes()


def test_plots_are_numbered_and_of_the_size_asked_for(tmp_path: Path) -> None:
    blocks = (FIGURES[1], Text(text="no plot"), FIGURES[10])
    section = Section(title="s", blocks=blocks)
    (tmp_path / "theirs").write_text("kept")
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "01-scales.svg").symlink_to(tmp_path / "theirs")
    drawing, document, *more = write_figures([section], tmp_path / "new", width_mm=127.0, height_mm=50.8)
    assert (tmp_path / "theirs").read_text() == "kept", "none is written through a link"
    assert [path.name for path in (drawing, document, *more)] == [
        "01-scales.svg", "01-scales.pdf", "02-chain.svg", "02-chain.pdf"
    ]  # fmt: skip
    size = ElementTree.parse(drawing).getroot()
    assert (size.get("width"), size.get("height")) == ("360pt", "144pt") and document.read_bytes().startswith(b"%PDF")


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A plot of counts with words of a stranger."""
    ages = Series(label="$x$", x=10 * np.arange(2.0), y=np.arange(2.0))
    plot = Figure(title="t", y_label="$^{$ \udcff", series=(ages, replace(ages, label="b")), integer_y=True)
    drawn, _ = write_figures([Section(title="s", blocks=(plot,))], tmp_path_factory.mktemp("drawing"))
    return drawn.read_text()


def test_a_dollar_sign_of_a_stranger_begins_no_formula(drawing: str) -> None:
    assert all(text in drawing for text in ("$^{$ \\udcff", "$x$"))


def test_what_is_counted_has_whole_ticks_and_a_legend_hides_what_is_behind_it(drawing: str) -> None:
    parts = [*ElementTree.fromstring(drawing).iter()]
    words = {part.text or "" for part in parts if part.tag.endswith("text")}
    assert {"0", "1"} <= words and not any("." in word for word in words)
    (legend,) = (part for part in parts if (part.get("id") or "").startswith("legend"))
    assert "opacity: 0.8" in ElementTree.tostring(legend[0], encoding="unicode")


def test_what_cannot_be_written_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HilError, match=r"--figures: .*file: cannot be made: File exists"):
        write_figures([], tmp_path / "file")
    with pytest.raises(HilError, match="cannot be made: File exists"):
        hil.report(hil.run("dc-motor-hinf", duration=1), output=tmp_path / "a.html", figures=tmp_path / "file")
    assert not (tmp_path / "a.html").exists(), "no page without its figures"
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(HilError, match="matplotlib is not installed"):
        write_figures([], tmp_path / "figures")
