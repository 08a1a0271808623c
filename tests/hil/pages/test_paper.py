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


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The files of a plot of counts with words of a stranger, and of a matrix; where the first goes is a link."""
    ages = Series(label="$x$", x=10 * np.arange(2.0), y=np.arange(2.0))
    plot = Figure(title="t", y_label="$^{$ \udcff", series=(ages, replace(ages, label="b")), integer_y=True)
    section = Section(title="s", blocks=(plot, Text(text="no plot"), FIGURES[10]))
    folder = tmp_path_factory.mktemp("plots")
    (folder / "theirs").write_text("kept")
    (folder / "new").mkdir()
    (folder / "new" / "01-t.svg").symlink_to(folder / "theirs")
    return write_figures([section], folder / "new", width_mm=127.0, height_mm=50.8)


def test_plots_are_numbered_and_of_the_size_asked_for(written: list[Path]) -> None:
    drawing, document, *_ = written
    assert (drawing.parents[1] / "theirs").read_text() == "kept", "none is written through a link"
    assert [path.name for path in written] == ["01-t.svg", "01-t.pdf", "02-chain.svg", "02-chain.pdf"]
    size = ElementTree.parse(drawing).getroot()
    assert (size.get("width"), size.get("height")) == ("360pt", "144pt") and document.read_bytes().startswith(b"%PDF")


def test_a_dollar_sign_of_a_stranger_begins_no_formula(written: list[Path]) -> None:
    assert all(text in written[0].read_text() for text in ("$^{$ \\udcff", "$x$"))


def test_what_is_counted_has_whole_ticks_and_a_legend_hides_what_is_behind_it(written: list[Path]) -> None:
    parts = [*ElementTree.parse(written[0]).iter()]
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
