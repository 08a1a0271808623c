"""A sweep over a part that is not ours has the numbers of its single runs, or says that it has not."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest

import hil
from design.controllers import LoopModel, RunningController
from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.errors import HilError
from hil.sweeps.lockstep import supports_batch
from hil.sweeps.seeds import foreign_parts
from plants.dc_motor import DCMotor
from tests.hil.compose.lying_plugins import Plant, Rowed, Table
from tests.hil.late_lies import LateTable


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


def test_a_part_that_is_another_one_when_pickled_is_refused() -> None:
    loop = load_experiment("dc-motor-h2", plant=Plant(), controller=OtherCopy(), duration=2, **{"limits.state": {}})
    with pytest.raises(HilError, match=r"OtherCopy: a sweep has other numbers than its runs: .* what is left of it when pickled"):
        hil.sweep(loop, runs=2, jobs=1)


def test_ours_are_trusted_by_their_file_and_not_by_a_name() -> None:
    assert foreign_parts(compose(load_experiment("dc-motor-h2"))) == ()
    named = type("DCMotor", (DCMotor,), {"__module__": "plants.dc_motor", "__qualname__": "DCMotor"})
    assert foreign_parts(compose(load_experiment("dc-motor-h2", plant=motor(named)))) == ("DCMotor",)


def test_a_run_at_once_is_compared_with_its_model_too() -> None:
    class Late(LateTable):
        def start_batch(self, model: LoopModel, runs: int) -> None:
            return None

    reported = {"plant": Plant(), "controller": Late(), "duration": 20, "limits.state": {}, "allow_uncertified": True}
    found = hil.sweep(load_experiment("dc-motor-h2", **reported), runs=2, jobs=1)
    assert found.caution.startswith("certificate withdrawn: the controller left its table at slot 30")
