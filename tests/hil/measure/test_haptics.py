"""The measure of a wall: its numbers are those of the run, and it keeps the contract of a measure."""

from __future__ import annotations

import numpy as np
import pytest

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.measure.check import check_measure
from hil.measure.haptics import Haptics
from hil.measure.view import view_of
from hil.runtime.virtual import simulate


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
