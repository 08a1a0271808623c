"""Sections that a plug-in draws: a figure from one class, data and never markup, and a page that is whole whatever it does."""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path
from textwrap import dedent
from typing import Any, ClassVar

import numpy as np
import pytest

import hil
import hil.compose as composing
import hil.measure as measure
import hil.rig as rig
from hil.cli import main
from hil.errors import HilError
from hil.files import PAGE
from hil.measure import network_paths
from hil.measure.view import RunView, view_of
from hil.pages import Badge, BarGroup, Bars, Figure, Marker, Section, Series, Text, paper
from hil.pages.html.page import Page
from hil.pages.run_page import render_report
from hil.pages.sections import plain_section
from hil.rig import delay_chains
from hil.rig.loop import Loop
from hil.session.replay import avatar
from plants.dc_motor import DCMotor
from tests.hil.pages.whole_pages import SECTIONS, lines
from transport.laws.age import ConstantAge

MINE = """
    import numpy as np
    from hil.measure import Quantity
    from hil.pages import Figure, Section, Series, Table

    class Effort:
        title, note, topics = "Effort", "", ("/actuator/applied",)

        def quantities(self, signals):
            return (Quantity(name="effort", title="input energy", unit="V² s", per_output=False),)

        def of(self, view):
            return {"effort": float(np.sum(view.applied() ** 2) * view.period_s)}

        def section(self, view):
            u = view.applied()[:, 0]
            t = view.period_s * np.arange(len(u))
            growth = Series(label="growth", x=t, y=np.cumsum(u**2) * view.period_s)
            figure = Figure(title="Growth of the effort", series=(growth,), y_unit="V² s")
            return Section(title="Where it went", place=15, blocks=(figure, Table(columns=["what"], rows=[["<b>all</b>"]])))
"""


pytestmark = pytest.mark.usefixtures("short_theory")


class Drawing(DCMotor):
    """A motor that draws what a test gives it."""

    shows: ClassVar[Any] = None

    def section(self, view: RunView) -> Any:
        return type(self).shows(view)


@cache
def drawn() -> hil.Session:
    return hil.run("dc-motor-hinf", seed=0, duration=1, plant=Drawing())


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Any:
    def page(shows: Any) -> str:
        monkeypatch.setattr(Drawing, "shows", staticmethod(shows))
        return render_report(view_of(drawn().run, drawn().experiment))

    return page


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(dedent(MINE))
    hil.run("dc-motor-hinf", seed=0, duration=0.5, log="run.mcap", **{"report.measures": ["tracking", "mine:Effort"]})
    return tmp_path


def test_number_figure_and_table_of_a_measure_come_from_one_class(mine: Path) -> None:
    assert hil.report("run.mcap", folder=mine) == (Path("run.html"),)
    page = (mine / "run.html").read_text()
    assert "Input energy" in page and "Growth of the effort" in page and "&lt;b&gt;all&lt;/b&gt;" in page and "<b>all" not in page
    titles = [page.index(f"<h2>{title}</h2>") for title in ("Tracking", "Where it went", "Delays")]
    assert titles == sorted(titles), "place=15 stands between 10 and 30"


class DrawingLaw(ConstantAge):
    """Ages that draw their own section."""

    def section(self, view: RunView) -> Section:
        return Section(title=f"Always {self.age} late", blocks=(Text(text="and never otherwise"),))


@pytest.mark.parametrize("direction", ["sc", "ca"])
def test_a_network_law_draws_its_section_in_either_direction(direction: str) -> None:
    changes = {f"network.{direction}.law": DrawingLaw(age=1), "allow_uncertified": True}
    session = hil.run("dc-motor-hinf", seed=0, duration=1, **changes)
    assert "<h2>Always 1 late</h2>" in render_report(view_of(session.run, session.experiment))


def test_a_log_alone_runs_no_module_for_its_page(mine: Path) -> None:
    hil.report("run.mcap", output="page.html")
    assert "Growth of the effort" not in (mine / "page.html").read_text()


def test_python_and_the_command_write_the_same_page(mine: Path) -> None:
    hil.report("run.mcap", output="a.html", folder=mine)
    with pytest.raises(SystemExit) as end:
        main(["report", "run.mcap", "-o", "b.html", "--folder", str(mine)])
    assert not end.value.code and (mine / "a.html").read_bytes() == (mine / "b.html").read_bytes()


def test_a_page_replaces_a_page_and_another_file_with_force_alone(tmp_path: Path) -> None:
    session = drawn()
    with pytest.raises(HilError, match="output="):
        hil.report(session)
    target = tmp_path / "page.html"
    assert hil.report(session, output=target) == (target,)
    target.write_text(f"{PAGE.decode()} of yesterday")
    assert hil.report(session, output=target) == (target,) and "yesterday" not in target.read_text()
    target.write_text("my notes")
    with pytest.raises(HilError, match="is no report"):
        hil.report(session, output=target)
    assert target.read_text() == "my notes"
    hil.report(session, output=target, force=True)
    assert "my notes" not in target.read_text()


def test_a_page_composes_once_and_asks_for_sensors_and_measures_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    hil.run("omni-slide", duration=1, log=tmp_path / "run.mcap", **{"report.measures": ["tracking", "haptics", "cost"]})
    asked: Counter[str] = Counter()

    def counting(module: Any, name: str) -> None:
        known = getattr(module, name)

        def counted(*args: Any, **keywords: Any) -> Any:
            asked[name] += 1
            return known(*args, **keywords)

        monkeypatch.setattr(module, name, counted)

    counting(avatar, "compose")
    counting(measure, "measures_of")
    for name in ("sensors_of", "shared_media", "traits_of", "fault_schedule", "port_of"):
        counting(rig, name)
    counting(delay_chains, "chains_of")
    counting(network_paths, "draws_of")
    monkeypatch.setattr(paper, "draw", lambda *_: None)  # of plain data: it asks for nothing
    monkeypatch.setattr(paper, "ENDINGS", ())
    assert composing.compose is not avatar.compose
    hil.report(tmp_path / "run.mcap", figures=tmp_path / "figures")
    assert asked == dict.fromkeys(asked, 1)
    assert asked.keys() == {
        "compose", "measures_of", "draws_of", "sensors_of", "shared_media", "traits_of", "fault_schedule", "port_of", "chains_of",
    }  # fmt: skip


@pytest.mark.parametrize(
    "shows",
    [
        lambda view: 1 / 0,
        lambda view: exec("raise SystemExit(7)"),
        lambda view: "<script>alert(1)</script>",
        lambda view: Section(title="T", blocks=("<script>alert(1)</script>",)),  # type: ignore[arg-type]
        lambda view: Section(title="T", blocks=(Figure(title="F", series=(Series(label="s", x=[0, 1], y=[0]),)),)),
        lambda view: Section(title="T", blocks=(Figure(title="F", series=(), markers=(Marker(x=np.nan, label="m"),)),)),
        lambda view: Section(title="T", blocks=(Figure(title="F", series=(), height_px="1\"><script>alert(1)</script>"),)),  # type: ignore[arg-type]
        lambda view: Section(title="T", blocks=(Figure(title="F", series=(), height_px=10**9),)),
        lambda view: Section(title="T", blocks=(Badge(label="b", state='x"><script>alert(1)</script>'),)),  # type: ignore[arg-type]
        lambda view: Section(
            title="T",
            blocks=(
                Bars(title="B", categories=["a"], groups=(BarGroup(label="g", values=[1.0], colour='%d"><script>alert(1)'),)),  # type: ignore[arg-type]
            ),
        ),
        lambda view: Section(title="T", blocks=(Text(text="x" * 2_000_001),)),
        lambda view: Section(title="T", blocks=(Text(text="<" * 1_900_000),)),  # each one is four characters of the page
    ],
)  # fmt: skip
def test_a_section_that_cannot_be_drawn_is_one_message_in_its_place(page: Any, shows: Any) -> None:
    found = page(shows)
    assert found.count("Drawing draws no section") == 1
    assert "<script>alert" not in found and found.count("<script") == found.count("</script>") == 3
    assert "<h2>Tracking</h2>" in found and "<h2>Provenance</h2>" in found and found.endswith("</html>\n")
    assert len(found) < 1_000_000


class Markup(str):
    """A text that escapes itself not."""

    def replace(self, *args: Any) -> str:  # type: ignore[override]
        return self

    def __str__(self) -> str:
        return "<script>alert(2)</script>"


def test_a_text_with_methods_of_its_own_is_escaped(page: Any) -> None:
    found = page(lambda view: Section(title=Markup("<i>"), blocks=(Text(text=Markup("<script>alert(1)</script>")),)))
    assert "&lt;i&gt;" in found and "&lt;script&gt;alert(1)" in found and "<i>" not in found and "<script>alert" not in found


def test_all_blocks_pass_as_they_are() -> None:
    for section in SECTIONS:
        copied, own = (str(lines(Page("t", [each]).html())) for each in (plain_section(section), section))
        assert copied.replace(".0", "") == own.replace(".0", ""), "counts are floats in a copy"


def test_the_check_says_whether_a_measure_draws(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hil_check("mine:Effort") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the page of a run has its section, here 'Where it went'" in said
    (mine / "plain.py").write_text((mine / "mine.py").read_text().replace("def section", "def draw"))
    assert hil_check("plain:Effort") == 0 and "it draws no figure" in capsys.readouterr().out
    (mine / "bad.py").write_text((mine / "mine.py").read_text().replace("blocks=(figure", "blocks=(figure, u"))
    assert hil_check("bad:Effort") == 2 and "section.blocks[1]: ndarray" in capsys.readouterr().err


def hil_check(measure: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(["check", "measures", measure])
    return int(end.value.code or 0)


def test_one_that_shows_nothing_leaves_no_trace(page: Any) -> None:
    found = page(lambda view: None)
    assert "<h2>Drawing" not in found and "draws no section" not in found


def test_a_view_of_one_output_shares_what_was_made() -> None:
    session = hil.run("vtol-hinf", duration=0.2)
    view = view_of(session.run, session.experiment)
    loop = view.once(avatar.composed)
    assert isinstance(loop, Loop) and view.only(view.signals.tracked[0]).once(avatar.composed) is loop
