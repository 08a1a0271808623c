"""A part of the user's own that raises or changes while it is asked before a run is one message that names it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import hil
from design.controllers import LoopModel
from hil.rig import rig_of
from tests.hil.compose.lying_plugins import Plant, Rowed, Table


@dataclass(frozen=True)
class Changing(Table):
    asked: int = 0

    def table(self, model: LoopModel) -> np.ndarray:
        object.__setattr__(self, "asked", self.asked + 1)
        return super().table(model)


class NoLaw:
    def linear_law(self, model: LoopModel) -> Any:
        return None

    def start(self, model: LoopModel) -> Rowed:
        return Rowed(Table(), model)


class LawThatFails(NoLaw):
    def linear_law(self, model: LoopModel) -> Any:
        raise RuntimeError("no licence")


class NoGains:
    def solve(self, task: Any) -> Any:
        return None


class Samples:
    selection = "applied"
    table = Table.table

    def start(self, model: LoopModel) -> Rowed:
        return Rowed(Table(), model)

    @property
    def samples(self) -> int:
        raise RuntimeError("no samples")


@dataclass(frozen=True)
class ModelOnce(Plant):
    def model(self) -> Any:
        CALLS.append(1)
        if len(CALLS) > 2:
            raise RuntimeError("no more models")
        return super().model()


CALLS: list[int] = []


@pytest.mark.parametrize(
    ("plant", "controller", "said"),
    [
        (Plant(), NoLaw(), "linear_law(model) returned None, expected a LinearLaw"),
        (Plant(), LawThatFails(), "linear_law(model): RuntimeError: no licence ("),
        (Plant(), NoGains(), "controller.kind: NoGains: solve(task) returned a NoneType, expected the controller that runs"),
        (Plant(), Samples(), "controller: RuntimeError: no samples ("),
        (ModelOnce(), Table(), "plant: RuntimeError: no more models ("),
    ],
)
def test_a_part_that_raises_before_the_run_is_one_message_with_its_line(plant: Any, controller: Any, said: str) -> None:
    CALLS.clear()
    with pytest.raises(hil.HilError) as reported:
        hil.run("dc-motor-h2", duration=1, plant=plant, controller=controller, allow_uncertified=True, **{"limits.state": {}})
    assert said in str(reported.value)
    assert "test_parts_that_fail.py, line " in str(reported.value) or "returned" in said


def test_a_controller_whose_fields_change_during_its_test_is_refused() -> None:
    changes: dict[str, Any] = {"plant": Plant(), "controller": Changing(), "limits.state": {}}
    with pytest.raises(hil.HilError, match=r"controller \(Changing\) or plant \(Plant\): fields changed while it was asked"):
        hil.run("dc-motor-h2", duration=1, allow_uncertified=True, **changes)


def test_what_asks_a_rig_and_composes_nothing_says_it_too() -> None:
    CALLS.clear()
    experiment = hil.load_experiment("dc-motor-h2", plant=ModelOnce(), **{"limits.state": {}})
    CALLS[:] = [1, 1]
    with pytest.raises(hil.HilError, match=r"plant: RuntimeError: no more models \(.*test_parts_that_fail\.py, line \d+\)"):
        rig_of(experiment)
