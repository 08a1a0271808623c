"""Measures: ours and a stranger's, chosen by the experiment, read by summary, sweep, table, tile and comparison."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from design.monte_carlo.parallel import Workers
from hil.errors import HilError
from hil.experiment import load as loading
from hil.experiment import load_experiment, plugins
from hil.log.read.run import read_run
from hil.measure import view as viewing
from hil.measure.check import check_measure
from hil.measure.measure import Measure, Quantity, measured, measures_of, quantities_of
from hil.measure.signals import Signals, signals_of
from hil.measure.summary import summarise
from hil.measure.tracking import Tracking
from hil.measure.view import RunView, view_of
from hil.pages.run.prediction import theory_section
from hil.pages.run.run_page import render_report
from hil.session import run_session
from hil.sweeps.seeds import columns_of, run_sweep
from tests.hil.pages.runs import run_of


class Effort:
    """A stranger's measure: the energy of the input."""

    title: ClassVar[str] = "Effort"
    note: ClassVar[str] = ""
    topics: ClassVar[tuple[str, ...]] = ("/actuator/applied",)

    def quantities(self, signals: Signals) -> tuple[Quantity, ...]:
        return (Quantity(name="effort", title="input energy", unit=f"{signals.input_unit()}² s", per_output=False),)

    def of(self, view: RunView) -> dict[str, float | None]:
        u = view.applied()
        return {"effort": float(np.sum(u**2) * view.period_s) if len(u) else None}


@pytest.fixture
def effort(monkeypatch: pytest.MonkeyPatch) -> None:
    known = plugins.load

    def load(group: plugins.Group, name: str, folder: str = ".") -> type:
        return Effort if (group, name) == ("hil.measures", "effort") else known(group, name)

    monkeypatch.setattr(plugins, "load", load)


@pytest.mark.usefixtures("effort")
def test_a_measure_of_ones_own_stands_in_summary_sweep_and_page(tmp_path: Path) -> None:
    experiment = load_experiment("dc-motor-hinf", ["duration=3", 'report.measures=["tracking", "effort"]'])
    session = run_session(experiment, path=tmp_path / "a.mcap")
    u = session.arrays["/actuator/applied"]["voltage"]
    assert session.metrics["effort"] == pytest.approx(float(np.sum(u**2)) * 0.05)
    assert session.summary["units"]["effort"] == "V² s" and session.summary["units"]["sse"] == "rad² s"
    assert columns_of(experiment)[-1] == "effort"
    swept = run_sweep(experiment, [0], workers=Workers()).values
    assert swept["effort"][0] == session.metrics["effort"]
    page = render_report(view_of(session.run, experiment), session.summary)
    assert "Input energy" in page and "input energy (V² s)" in page


def test_both_measures_keep_what_the_check_asks() -> None:
    for name in ("dc-motor-hinf", "vtol-fault"):
        view = view_of(run_of(name, "duration=1"))
        check_measure(Tracking(), view)
        check_measure(Effort(), view)


class _Nan(Effort):
    def of(self, view: RunView) -> dict[str, float | None]:
        return {"effort": float("nan")}


class _Other(Effort):
    def of(self, view: RunView) -> dict[str, float | None]:
        return {"work": 1.0}


class _Greedy(Effort):
    def of(self, view: RunView) -> dict[str, float | None]:
        return {"effort": float(len(view.run.arrays.get("/plant/state", ())))}


class _Counting(Effort):
    calls = 0

    def of(self, view: RunView) -> dict[str, float | None]:
        self.calls += 1
        return {"effort": float(self.calls)}


@pytest.mark.parametrize(
    ("measure", "fault"),
    [(object(), "title"), (_Nan(), "is nan"), (_Other(), "work"), (_Greedy(), "topics"), (_Counting(), "numbers")],
)
def test_the_check_says_what_a_measure_does_not_keep(measure: object, fault: str) -> None:
    with pytest.raises(AssertionError, match=fault):
        check_measure(measure, view_of(run_of("dc-motor-hinf", "duration=1")))


def test_an_unknown_or_doubled_measure_is_a_fault_of_the_experiment() -> None:
    with pytest.raises(HilError, match=r"report\.measures\[0\]: no measure plug-in is called 'trackin'; did you mean 'tracking'"):
        load_experiment("dc-motor-hinf", ['report.measures=["trackin"]'])
    with pytest.raises(HilError, match=r"report\.measures\[1\]: 'tracking' is named twice"):
        load_experiment("dc-motor-hinf", ['report.measures=["tracking", "tracking"]'])


def test_two_measures_with_one_name_for_two_numbers_are_refused() -> None:
    signals = signals_of(load_experiment("dc-motor-hinf").plant)
    with pytest.raises(HilError, match="two of them give a number called 'effort'"):
        quantities_of([Effort(), Effort()], signals)


def test_outputs_that_follow_nothing_are_measured_by_no_one() -> None:
    view = view_of(run_of("vtol-fault", "duration=1"))
    measures: tuple[Measure, ...] = measures_of(view.experiment)
    assert "detected_mode" in view.signals.outputs and "detected_mode" not in view.signals.tracked
    assert set(measured(view, measures)["outputs"]) == set(view.signals.tracked)


def test_a_page_parses_its_experiment_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_session(load_experiment("dc-motor-hinf", ["duration=2"]), path=tmp_path / "a.mcap")
    parsed: list[str] = []
    known = loading.experiment_from_resolved

    def counting(resolved: Mapping[str, Any], text: str, source: str) -> Any:
        parsed.append(source)
        return known(resolved, text, source)

    monkeypatch.setattr(viewing, "experiment_from_resolved", counting)
    view = view_of(read_run(tmp_path / "a.mcap"))
    summary = summarise(view)
    section = theory_section(view)
    render_report(view, summary, sections=[section] if section is not None else [])
    assert len(parsed) == 1
