"""A sweep over a part that is not ours has the numbers of its single runs, or says that it has not."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from design.controllers import LoopModel, RunningController
from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.errors import HilError
from hil.sweeps import SweepStore
from hil.sweeps.lockstep import supports_batch
from hil.sweeps.seeds import columns_of, foreign_parts, here, run_sweep
from plants.dc_motor import DCMotor
from tests.hil.compose.lying_plugins import Plant, Rowed, Table
from tests.hil.late_lies import LateTable
from transport import MarkovAge


class PlainMotor(DCMotor):
    """Ours under another name: it inherits what ours can do."""


class TurnedMotor(DCMotor):
    """It starts elsewhere than ours, and forgets that it inherits `start_batch`."""

    def start(self, rng: np.random.Generator) -> Any:
        given = {f.name: getattr(self, f.name) for f in fields(DCMotor)}
        return replace(DCMotor(**given), initial_angle_rad=0.5).start(rng)


def motor(cls: type[DCMotor]) -> DCMotor:
    plant = load_experiment("dc-motor-h2").plant
    return cls(**{f.name: getattr(plant, f.name) for f in fields(DCMotor)})


def test_a_plant_that_inherits_start_many_and_moves_otherwise_is_refused() -> None:
    loop = compose(load_experiment("dc-motor-h2", plant=motor(TurnedMotor), duration=2))
    assert supports_batch(loop) and foreign_parts(loop) == ("TurnedMotor",)
    said = r"TurnedMotor: a sweep has other numbers than its runs: sse of seed 0 is .* start_batch"
    with pytest.raises(HilError, match=said):
        hil.sweep(loop.experiment, runs=3, jobs=1)
    with pytest.raises(HilError, match=said):
        hil.compare(loop.experiment, "dc-motor-hinf", runs=3, jobs=1)


class Unformed(DCMotor):
    def start_batch(self, runs: int) -> Any:
        return object()


class Leaving(DCMotor):
    def start_batch(self, runs: int) -> Any:
        sys.exit(0)


@pytest.mark.parametrize(
    ("plant", "said"),
    [(Unformed, r"Unformed: it returned .*'object' object has no attribute 'state'"), (Leaving, rf"Exit: 0 \({__file__}, line")],
)
def test_a_batch_that_is_none_is_one_message(plant: type[DCMotor], said: str) -> None:
    with pytest.raises(HilError, match=said):
        hil.sweep("dc-motor-h2", runs=2, jobs=1, duration=1, plant=motor(plant))


def test_one_that_moves_as_ours_has_the_numbers_of_ours() -> None:
    ours, own = (
        hil.sweep("dc-motor-h2", runs=3, jobs=1, duration=2, **changes) for changes in ({}, {"plant": motor(PlainMotor)})
    )
    assert {name: column.tolist() for name, column in own.values.items() if name != "settling_time_s"}.keys() >= {"seed", "sse"}
    assert own.values["sse"].tolist() == ours.values["sse"].tolist() and own.caution == ours.caution


@dataclass(frozen=True)
class OtherCopy(Table):
    """A table that is another one in every process but its author's."""

    gain: float = 1.0

    def __reduce__(self) -> Any:
        return OtherCopy, ("none", "applied", 1, False, -3.0)

    def start(self, model: LoopModel) -> RunningController:
        running, gain = Rowed(self, model), self.gain

        class Run:
            selection = running.selection

            def rows(self, *asked: Any) -> Any:
                return tuple(tuple(gain * u for u in row) for row in running.rows(*asked))

        return Run()


MEASURED = """
import numpy as np
from hil.measure import Quantity

class Energy:
    title, note, topics = "Energy", "", ("/actuator/applied",)

    def quantities(self, signals):
        return (Quantity(name="energy", title="input energy", unit="V² s", per_output=False),)

    def of(self, view):
        return {{"energy": float(np.sum(view.applied()[:, 0] ** 2))}}

    def of_batch(self, view):
        e = np.array([np.sum(run**2) for run in view.inputs[0]])
        return {given}
"""
AT_ONCE = {
    "the first of all": (
        "{'energy': np.full(len(e), e[0])}", r"Energy: a sweep has other numbers than its runs: energy of seed 3 is ",
    ),
    "one number": ("{'energy': e[0]}", r"of_batch\(view\): energy has shape \(\); expected shape \(2,\)"),
    "a column": ("{'energy': e[:, None]}", r"of_batch\(view\): energy has shape \(2, 1\); expected shape \(2,\)"),
    "another name": ("{'energie': e}", r"of_batch\(view\): energy is missing; expected shape \(2,\)"),
    "an exit": ("{'energy': __import__('sys').exit(0)}", r"Energy: of_batch\(view\): SystemExit: 0 \(.*measured\.py, line 16\)"),
    "no number": ("{'energy': np.linalg.inv(e)}", r"Energy: of_batch\(view\): LinAlgError: .*measured\.py, line 16\)"),
}


@pytest.mark.parametrize("what", AT_ONCE)
def test_numbers_of_all_runs_at_once_are_those_of_the_first_and_the_last(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given, said = AT_ONCE[what]
    monkeypatch.chdir(tmp_path)
    changes: dict[str, Any] = {"report.measures": ["tracking", "measured:Energy"]}
    Path("measured.py").write_text(MEASURED.format(given=given))
    with pytest.raises(HilError, match=said):
        hil.sweep("dc-motor-h2", runs=4, jobs=1, duration=3, **changes)


class OneStream(MarkovAge):
    """Ours, but all runs at once have the delays of the first."""

    def ages_of_batch(self, rngs: Iterable[np.random.Generator], runs: int, slots: int) -> Any:
        return np.repeat(super().ages_of_batch(rngs, runs, slots)[:, :1], runs, axis=1)


def test_delays_of_all_runs_at_once_that_are_those_of_the_first_are_refused() -> None:
    law = OneStream(matrix=((0.5, 0.5), (0.5, 0.5)))
    with pytest.raises(HilError, match=r"OneStream: a sweep has other numbers than its runs: .* of seed 3 "):
        hil.sweep("dc-motor-h2", runs=4, jobs=1, duration=3, **{"network.sc.law": law})


def test_a_part_that_is_another_one_when_pickled_is_refused() -> None:
    loop = load_experiment("dc-motor-h2", plant=Plant(), controller=OtherCopy(), duration=2, **{"limits.state": {}})
    with pytest.raises(HilError, match=r"OtherCopy: a sweep has other numbers than its runs: .* what is left of it when pickled"):
        hil.sweep(loop, runs=2, jobs=1)


def test_runs_that_a_file_has_kept_of_another_code_are_refused_before_more_are_kept(tmp_path: Path) -> None:
    experiment = load_experiment("dc-motor-h2", plant=motor(PlainMotor), duration=2)
    with SweepStore(tmp_path / "kept", experiment, columns_of(experiment)) as store:
        run_sweep(experiment, range(2), workers=here(1), store=store)
        store.rows[0] = store.rows[0] | {"sse": 1.0}
        with pytest.raises(HilError, match=r"PlainMotor: .* sse of seed 0 is 1 in --resume .*kept and .* in another file"):
            run_sweep(experiment, range(3), workers=here(1), store=store)
        assert sorted(store.rows) == [0, 1]


def test_ours_are_trusted_by_their_file_and_not_by_a_name() -> None:
    assert foreign_parts(compose(load_experiment("dc-motor-h2"))) == ()
    named = type("DCMotor", (DCMotor,), {"__module__": "plants.dc_motor", "__qualname__": "DCMotor"})
    assert foreign_parts(compose(load_experiment("dc-motor-h2", plant=motor(named)))) == ("DCMotor",)


@pytest.mark.parametrize(("gain", "state"), [(-1.2, "refused"), (-0.1, None)])
def test_a_sweep_over_a_loop_that_is_not_certified_says_so(gain: float, state: str | None) -> None:
    changes = {"controller.gain": [[gain]], "allow_uncertified": True, "duration": 1, "limits.state": {}}
    said = hil.sweep("dc-motor-local", runs=2, jobs=1, **changes).caution
    assert said.startswith(f"the loop is {state}, mean-square stability: ") if state else said == ""


def test_a_run_at_once_is_compared_with_its_model_too() -> None:
    class Late(LateTable):
        def start_batch(self, model: LoopModel, runs: int) -> None:
            return None

    reported = {"plant": Plant(), "controller": Late(), "duration": 20, "limits.state": {}, "allow_uncertified": True}
    found = hil.sweep(load_experiment("dc-motor-h2", **reported), runs=2, jobs=1)
    assert found.caution.startswith("certificate withdrawn: the controller left its table at slot 30")
