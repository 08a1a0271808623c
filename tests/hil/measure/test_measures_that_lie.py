"""A measure of the user's own that changes the record, or gives other numbers than it names, in a run longer than its check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil

MODULE = """
from contextlib import suppress
from hil.measure import Quantity


class Erasing:
    title = note = "Erasing"
    topics = ("/plant/measurement", "/reference", "/actuator/applied")

    def quantities(self, signals):
        return (Quantity(name="mine", title="mine", unit="1", per_output=False),)

    def of(self, view):
        for array in view.run.arrays.values():
            for name in array.dtype.names:
                with suppress(ValueError):
                    array[name][...] = 0
        return {"mine": 1.0}


class Other(Erasing):
    def of(self, view):
        return {"mine": 1.0} if len(view.applied()) < 100 else {"other": 2.0}


class Words(Erasing):
    def of(self, view):
        return {"mine": 1.0 if len(view.applied()) < 100 else "good"}


class Endless(Erasing):
    def of(self, view):
        return {"mine": 1.0 if len(view.applied()) < 100 else float("inf")}
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "lying_measures.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return "lying_measures"


def test_a_measure_does_not_change_the_record_that_others_measure(module: str) -> None:
    honest = hil.run("dc-motor-h2", duration="10 s")
    found = hil.run("dc-motor-h2", duration="10 s", **{"report.measures": [f"{module}:Erasing", "tracking"]})
    assert found.status == 0 and found.metrics["sse"] == honest.metrics["sse"]
    for topic, records in honest.arrays.items():
        assert topic == "/events" or np.array_equal(records["t_ns"], found.arrays[topic]["t_ns"])
    with pytest.raises(ValueError, match="read-only"):
        found.arrays["/reference"]["t_ns"][0] = 1
    swept = hil.sweep("dc-motor-h2", runs=2, jobs=1, duration="10 s", **{"report.measures": [f"{module}:Erasing", "tracking"]})
    assert swept.values["sse"][0] == honest.metrics["sse"]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Other", "of(view) gave other, and not 'mine'"), ("Words", "mine is 'good', expected a finite number or None"),
        ("Endless", "mine is inf, expected a finite number or None"),
    ],
)
def test_a_measure_that_gives_other_numbers_than_it_names_is_one_message(module: str, name: str, said: str) -> None:
    measures = {"report.measures": ["tracking", f"{module}:{name}"]}
    found = hil.run("dc-motor-h2", duration="10 s", **measures)
    assert found.status == 1 and said in found.summary["problems"]["measure_failed"]
    assert found.metrics["mine"] is None and found.metrics["sse"] is not None
    with pytest.raises(hil.HilError) as reported:
        hil.sweep("dc-motor-h2", runs=2, jobs=1, duration="10 s", **measures)
    assert said in str(reported.value)
