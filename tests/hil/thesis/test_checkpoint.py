"""A reproduction that was interrupted goes on: stages come back as they were found, and only they."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

import hil.thesis
from hil.cli.reproduce import command
from hil.errors import HilError
from hil.pages import Band, BarGroup, Bars, Figure, Histogram, Marker, Series
from hil.thesis import Chapter, Part, Plot, Stage, compute
from hil.thesis.checkpoint import KeptStages
from hil.thesis.pages import chapter_page
from hil.thesis.statements import Statement, below, equal, not_judged, run, says

X = np.linspace(0.0, 1.0, 5)


def numbers(number: float = 0.5) -> dict[str, Any]:
    series, band = Series(label="x", x=X, y=X**2), Band(label="b", x=X, lower=X, upper=X + 1.0)
    panels = (
        Figure(title="f", series=(series,), bands=(band,), markers=(Marker(x=0.5, label="m"),), y_range=(0.0, 2.0)),
        Bars(title="b", categories=["one"], groups=(BarGroup(label="g", values=[1.0]),)),
        Histogram(title="h", edges=X, counts=np.arange(4)),
    )
    return {"x": number, "y": 1.0, "runs": X, "w": "y", "z": float("inf"), "figures": (Plot(title="p", panels=panels),)}


CLAIMS = (
    below("x", "x", 1), equal("y", "y", "1.00"), run("share", "runs", "0.5"), says("w", "w", "y"), not_judged("t", "y", "why"),
)  # fmt: skip
SAID = (Statement("a", "1", CLAIMS, (below("z", "z", 1),), beside=(below("x", "x", 1),), readings=True),)


def a_part() -> Part:
    return Stage("s", lambda report_progress: numbers(), 1.0, SAID).part(lambda text, done=0, total=0: None)


def chapter(calls: list[str], stops_at: str = "") -> Chapter:
    def stage(title: str) -> Stage:
        def work(report_progress) -> dict[str, Any]:
            calls.append(title)
            if title == stops_at:
                raise KeyboardInterrupt
            report_progress("half", 1, 2)
            return numbers()

        return Stage(title, work, 10.0, SAID)

    return Chapter(title="C", stages=tuple(stage(title) for title in ("one", "two", "three")))


def test_a_second_call_goes_on_where_the_first_was_stopped(tmp_path: Path) -> None:
    calls: list[str] = []
    with KeptStages(tmp_path / "state") as kept, pytest.raises(KeyboardInterrupt):
        compute(chapter(calls, "two"), lambda step: None, "c", kept)
    computed = []
    with KeptStages(tmp_path / "state") as kept:
        found = compute(chapter(calls), lambda step: computed.append(step.seconds), "c", kept)
    assert calls == ["one", "two", "two", "three"]
    assert computed == [0.0, 5.0, 10.0, 15.0]
    whole = compute(chapter([]), lambda step: None)
    assert json.dumps(found.to_json()) == json.dumps(whole.to_json()) and chapter_page(found) == chapter_page(whole)


def test_what_other_code_found_is_not_taken_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with KeptStages(tmp_path / "state") as kept:
        kept.put("c", "one", a_part())
    with KeptStages(tmp_path / "state") as kept:
        assert kept.get("c", "one") is not None
    monkeypatch.setattr("hil.thesis.checkpoint.digest_of_code", lambda: "another")
    with KeptStages(tmp_path / "state") as kept:
        assert not kept.stages


@pytest.mark.parametrize("end", [b"", b"{", b64encode(b"\x93\xa1c\xa1s")])
def test_a_torn_line_is_cut_off(tmp_path: Path, end: bytes) -> None:
    state = tmp_path / "state"
    with KeptStages(state) as kept:
        kept.put("c", "one", a_part())
    whole = state.read_bytes()
    state.write_bytes(whole + end)
    with KeptStages(state) as kept:
        assert list(kept.stages) == [("c", "one")]
    assert state.read_bytes() == whole
    state.write_bytes(whole[:30])  # torn in its first line
    with KeptStages(state) as kept:
        assert not kept.stages


PART = {"rows": [], "figures": [{"title": "p", "panels": [{"type": "Bars", "title": "b", "categories": [], "groups": []}]}]}


def one_stage(part: object, **changed: object) -> bytes:
    """A line as it is kept, of a part or of another one."""
    return b64encode(msgspec.msgpack.encode(("c", "s", {**part, **changed} if isinstance(part, dict) else part)))


def test_a_line_is_what_a_part_is_made_of(tmp_path: Path) -> None:
    state = tmp_path / "state"
    KeptStages(state).__exit__(None, None, None)
    with state.open("ab") as file:
        file.write(one_stage(PART) + b"\n")
    with KeptStages(state) as kept:
        part = kept.get("c", "s")
        assert part is not None and part.figures == (Plot(title="p", panels=(Bars(title="b", categories=[], groups=()),)),)


@pytest.mark.parametrize(
    "line",
    [b"notes\n", b'{"format": "x"}\n', b'{\n "mine": 1\n}\n', b"\nnotes\n", b"{\n", None, b"notes", b"{}", b"\xff", one_stage(3),
     b64encode(b"\xdd\xff\xff\xff\xff"), b64encode(b"\x91" * 100_000), one_stage(PART, rows=5), one_stage(PART, rows=[{}]),
     one_stage(PART, figures=[{"title": 3, "panels": []}]), one_stage(PART, figures=[{"title": "", "panels": [3]}]),
     one_stage(PART, figures=[{"title": "", "panels": [{"type": "Path", "title": ""}]}]),
     one_stage(PART, rows=[{"item": "", "printed": "", "computed": "", "checks": []}])],
)  # fmt: skip
def test_a_file_of_another_kind_is_refused_and_left(tmp_path: Path, line: bytes | None) -> None:
    state = tmp_path / "state"
    if line is None:
        state.mkdir()
    elif line.endswith(b"\n"):
        state.write_bytes(line)
    else:
        KeptStages(state).__exit__(None, None, None)
        with state.open("ab") as file:
            file.write(line + b"\n")
    before = None if line is None else state.read_bytes()
    with pytest.raises(HilError, match="state") as refused:
        KeptStages(state)
    with pytest.raises(HilError, match=re.escape(str(refused.value))):  # and not that it is in use
        KeptStages(state)
    assert line is None or state.read_bytes() == before


def test_a_state_belongs_to_one_at_a_time(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "state")
    with pytest.raises(HilError, match="link"):
        KeptStages(tmp_path / "link")
    with KeptStages(tmp_path / "state"), pytest.raises(HilError, match="in use"):
        KeptStages(tmp_path / "state")


def test_the_command_keeps_goes_on_and_cleans_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    stops = ["two"]
    monkeypatch.setattr(hil.thesis, "chapters", lambda: ("ch2", "ch3"))
    monkeypatch.setattr(hil.thesis, "_asked", lambda name: chapter(calls, stops[0] if name == "ch3" else ""))
    pages = tmp_path / "pages"
    first = CliRunner().invoke(command, ["all", "-o", str(pages)])
    assert first.exit_code != 0 and {p.name for p in pages.iterdir()} == {"ch2.html", "reproduce.state"}
    assert f"the same command goes on: 4 stages are in {pages / 'reproduce.state'}" in first.stderr
    stops[0] = ""
    again = CliRunner().invoke(command, ["all", "-o", str(pages)])
    assert again.exit_code == 0 and "goes on: 4 stages" in again.stderr
    assert calls == ["one", "two", "three", "one", "two", "two", "three"]
    assert {p.name for p in pages.iterdir()} == {"ch2.html", "ch3.html", "index.html"}


def test_what_one_interrupted_stage_leaves_is_reported_and_nothing_where_nothing_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for stops, reported in (("one", ""), ("two", "goes on: 1 stage is in")):
        monkeypatch.setattr(hil.thesis, "_asked", lambda name, stops=stops: chapter([], stops))
        done = CliRunner().invoke(command, ["ch2", "-o", str(tmp_path / f"{stops}.html")])
        assert done.exit_code != 0 and ("goes on" in done.stderr) == bool(reported) and reported in done.stderr
