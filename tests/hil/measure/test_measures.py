"""Measures: ours and a foreign one, chosen by the experiment, read by summary, sweep, table, tile and comparison."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest

from design.monte_carlo import Workers
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import experiment_from_resolved, load_experiment
from hil.experiment.tables import Report
from hil.log.read import read_run
from hil.measure import Measure, Quantity, measured, measures_of, quantities_of
from hil.measure import view as viewing
from hil.measure.check import check_measure
from hil.measure.haptics import Haptics
from hil.measure.signals import Signals, signals_of
from hil.measure.tracking import Tracking
from hil.measure.view import RunView, view_of
from hil.pages.run_page import render_report
from hil.plugins import registry
from hil.runtime.virtual import simulate
from hil.session import run_session
from hil.sweeps.seeds import columns_of, run_sweep
from tests.hil.pages.runs import run_of


class Effort:
    """A foreign measure: the energy of the input."""

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
    known = registry.load

    def load(group: registry.Group, name: str, folder: str = ".") -> type:
        return Effort if (group, name) == ("hil.measures", "effort") else known(group, name)

    monkeypatch.setattr(registry, "load", load)


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
    page = render_report(view_of(session.run, experiment))
    assert "Input energy" in page and "input energy (V² s)" in page


CALLS = count()


@pytest.mark.parametrize(
    ("name", "instead", "fault"),
    [
        ("of", lambda self, view: {"effort": float("nan")}, "is nan"), ("of", lambda self, view: {"work": 1.0}, "work"),
        ("of", lambda self, view: {"effort": float(len(view.run.arrays.get("/plant/state", ())))}, "alone, its topics"),
        ("of", lambda self, view: {"effort": float(next(CALLS))}, "the same run must give the same numbers"),
        ("of", lambda self, view: {"effort": "much"}, "a run: effort is 'much', expected a number, or None"),
        ("of", lambda self, view: {"effort": True}, "a run: effort is True, expected a number, or None"),
        ("of", lambda self, view: {"effort": np.ones((20, 9))}, r"effort is array.*, expected a number, or None"),
        ("title", 3, "title is 3, expected text"), ("note", False, "note is False, expected text"),
        ("quantities", lambda self, signals: (Quantity(name="effort", title="energy", unit=3),),
         r"quantities\(signals\) gave Quantity\(name='effort'.*: Expected `str`, got `int` - at `\$.unit`"),
        ("quantities", lambda self, signals: (), "a measure has at least one quantity"), ("title", None, "title"),
    ],
)  # fmt: skip
def test_the_check_says_what_a_measure_does_not_keep(
    name: str, instead: object, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if instead is None:
        monkeypatch.delattr(Effort, name)
    else:
        monkeypatch.setattr(Effort, name, instead)
    with pytest.raises(AssertionError, match=fault):
        check_measure(Effort(), view_of(run_of("dc-motor-hinf", "duration=1")))


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
    known = experiment_from_resolved

    def counting(resolved: Mapping[str, Any], text: str, source: str) -> Any:
        parsed.append(source)
        return known(resolved, text, source)

    monkeypatch.setattr(viewing, "experiment_from_resolved", counting)
    view = view_of(read_run(tmp_path / "a.mcap"))
    render_report(view)
    assert len(parsed) == 1


OWN = """
from hil.measure import Quantity

class Whole:
    title, note, topics = "Mine", "", ("/actuator/applied",)
    def quantities(self, signals):
        return (Quantity(name="mine", title="mine", per_output=False),)
    def of(self, view):
        return {"mine": float(len(view.applied()))}

class Late(Whole):
    def of(self, view):
        if len(view.applied()) > 20:
            raise Base("in the end")
        return {"mine": 1.0}

class Base(BaseException): pass
class NoUnits(Whole):
    quantities = None
    def __getattribute__(self, name):
        if name == "quantities": raise AttributeError(name)
        return super().__getattribute__(name)
class Asks(Whole):
    def __init__(self, gain): pass
class Pairs(Whole):
    def quantities(self, signals): return (("mine", "V"),)
class Number(Whole):
    def of(self, view): return 3.0
class Text(Whole):
    def of(self, view): return {"mine": "many"}
class Fails(Whole):
    def of(self, view): return {"mine": view.applied()[17]["nothing"]}
class Leaves(Whole):
    def of(self, view): raise SystemExit(0)
class Typo(Whole):
    topics = ("/actuator/aplied",)
class Word(Whole):
    topics = "/actuator/applied"
class Other(Whole):
    topics = ("/plant/state",)
"""


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("NoUnits", r"NoUnits, a measure, needs `quantities` \(quantities\(signals\) gives a Quantity"),
        ("Asks", r"TypeError: .*missing 1 required positional argument: 'gain'"),
        ("Pairs", r"quantities\(signals\) gave \('mine', 'V'\), expected .*Quantity objects"),
        ("Number", r"a run: of\(view\) returned 3\.0, expected numbers by name"),
        ("Text", r"a run: mine is 'many', expected a number, or None"),
        ("Fails", r"a run: of\(view\): IndexError: .* \(.*mine\.py, line \d+\)"),
        ("Leaves", r"a run: of\(view\): SystemExit: 0 \(.*mine\.py, line \d+\)"),
        ("Typo", r"topics: no topic is called '/actuator/aplied'; did you mean '/actuator/applied'\?"),
        ("Word", r"topics is '/actuator/applied', expected a tuple of names"),
        ("Other", r"with \('/plant/state',\) alone, its topics: of\(view\): MissingTopic: topic /actuator/applied: this log"),
    ],
)
def test_a_measure_of_a_file_is_checked_before_the_run(tmp_path: Path, name: str, reported: str) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    experiment = load_experiment("dc-motor-hinf", ["duration=2"])
    experiment = msgspec.structs.replace(experiment, folder=str(tmp_path), report=Report(measures=("tracking", f"mine:{name}")))
    with pytest.raises(HilError, match=r"report\.measures.*mine:" + name + ".*" + reported):
        run_session(experiment, path=tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()
    with pytest.raises(HilError, match=reported):
        run_sweep(experiment, [0], workers=Workers())
    if name == "Pairs":  # before anything is composed
        with pytest.raises(HilError, match=r"report\.measures: Pairs: quantities\(signals\) gave"):
            columns_of(experiment)
    if name in ("NoUnits", "Asks"):  # of a log that names it nothing runs
        with pytest.raises(HilError, match=f"report.measures: 'mine:{name}'(: .*TypeError| is no measure: it lacks title, note)"):
            measures_of(experiment)


def test_a_measure_that_fails_behind_its_check_leaves_the_log_and_the_other_numbers(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    experiment = load_experiment("dc-motor-hinf", ["duration=2"])
    experiment = msgspec.structs.replace(experiment, folder=str(tmp_path), report=Report(measures=("tracking", "mine:Late")))
    session = run_session(experiment, path=tmp_path / "a.mcap")
    reported = session.summary["problems"]["measure_failed"]
    assert session.status == 1 and reported.startswith("measure Late: Base: in the end (") and "mine.py, line 14" in reported
    assert session.metrics["mine"] is None and session.metrics["sse"] > 0
    assert len(read_run(tmp_path / "a.mcap").arrays["/actuator/applied"]) == 40


def test_a_check_says_what_the_measure_has_earned() -> None:
    for name in ("dc-motor-hinf", "vtol-fault"):
        view = view_of(run_of(name, "duration=1"))
        told = "Tracking is a BatchMeasure: a sweep asks it for all runs at once, and compares two with of(view)"
        assert check_measure(Tracking(), view)[1] == told
        assert check_measure(Effort(), view)[1] == "Effort is no BatchMeasure (no of_batch): a sweep runs seed by seed"


def test_the_numbers_are_those_of_the_log() -> None:
    e = load_experiment("omni-push")
    view = view_of(simulate(compose(e), 0), e)
    check_measure(Haptics(), view)
    found = Haptics().of(view)
    position = view.run.arrays["/plant/measurement"]["position"]
    assert found["final_depth"] == pytest.approx(134.816, abs=1e-3)
    assert found["largest_depth"] == 1e3 * position.max() and found["energy_given"] == 0.0
    assert found["largest_force"] == np.abs(view.run.arrays["/actuator/applied"]["force"]).max()


def test_a_wall_that_gives_energy_away_is_seen() -> None:
    e = load_experiment("omni-theorem61", ["allow_uncertified=true"])
    found = Haptics().of(view_of(simulate(compose(e), 0), e))
    assert found["energy_given"] is not None and found["energy_given"] > 10.0
