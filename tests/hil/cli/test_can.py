"""`hil can analyse`: tables of traffic and experiments, with bounds beside what was measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli.can import command
from hil.errors import HilError
from tests.transport.can_analysis.sae import BOUNDS_MS, SAE


def run(*words: str) -> str:
    done = CliRunner().invoke(command, ["analyse", *words], catch_exceptions=False, standalone_mode=False)
    return done.output


@pytest.fixture
def sae(tmp_path: Path) -> Path:
    rows = [f"{each.name},{each.identifier:#x},{each.period_ns / 1e6:g} ms,{each.length}" for each in SAE]
    (tmp_path / "sae.csv").write_text("\n".join(["name,can_id,period,length", *rows]))
    return tmp_path / "sae.csv"


def test_a_table_of_traffic_has_its_bounds_and_what_was_measured_below_them(sae: Path, tmp_path: Path) -> None:
    page = tmp_path / "bus.html"
    found = json.loads(run(str(sae), "--bitrate", "125k", "--duration", "2", "--json", "-o", str(page)))
    assert [each["bound_ms"] for each in found["messages"]] == list(BOUNDS_MS) and round(found["load"], 4) == 0.8574
    assert all(0 < each["measured_ms"] <= each["bound_ms"] for each in found["messages"])
    assert found["messages"][2]["delayed_by"] == ["SAE 1", "SAE 2"]
    assert "every message meets its deadline" in page.read_text() and "SAE 17" in page.read_text()
    assert "every message meets its deadline" in run(str(sae), "--bitrate", "125k", "--duration", "0.1")


def test_errors_and_too_slow_a_bus_are_said(sae: Path) -> None:
    worse = json.loads(run(str(sae), "--bitrate", "125k", "--duration", "0.1", "--errors", "2", "--json"))
    assert all(each["bound_ms"] > bound for each, bound in zip(worse["messages"], BOUNDS_MS))
    said = run(str(sae), "--bitrate", "100k", "--duration", "1")
    assert "The messages need 107.2 % of the bus" in said and "may miss their deadline" in said and "none" in said


def test_an_experiment_is_run_and_analysed() -> None:
    found = json.loads(run("dc-motor-busy-can", "--duration", "1", "--json"))
    own = {each["name"]: each for each in found["messages"]}
    assert own["motor"]["bound_ms"] == 39.656 and 0 < own["controller"]["measured_ms"] < own["controller"]["bound_ms"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["x.csv"], "--bitrate: missing; x.csv says no bit rate"),
        (["x.csv", "--bitrate", "501k"], "--bitrate: 501000 bit/s: no whole part of 80000000 Hz; the nearest possible is 500000"),
        (["x.csv", "--bitrate", "500k"], "x.csv"),
        (["dc-motor-hinf"], "dc-motor-hinf: no medium of kind 'can'"),
        (["dc-motor-busy-can", "--bitrate", "500k"], "--bitrate: an experiment says it itself"),
    ],
)
def test_what_cannot_be_analysed_is_refused(words: list[str], said: str) -> None:
    with pytest.raises(HilError) as caught:
        run(*words)
    assert said in str(caught.value)
