"""Gains over historical data for a plant whose input is split in two."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest

from hil.api.experiment_source import load_experiment
from hil.compose import compose
from plants.delayed_states import B_5_4


@pytest.mark.parametrize("weight", [0.0, 0.5])
def test_two_inputs_that_share_what_one_does_are_commanded_alike_and_move_the_plant_as_that_one(weight: float) -> None:
    """With B = [b b] / sqrt(2) and the same weight on each input the best commands are u / sqrt(2) each: B K stays."""
    moved = []
    for inputs in (1, 2):
        B = [[b / sqrt(inputs)] * inputs for (b,) in B_5_4]
        changes = {"plant.B": B, "controller.input_weight": weight, "limits.input": [100.0] * inputs, "allow_uncertified": True}
        loop = compose(load_experiment("multisensor-ours", **changes), certify=False)
        gains = np.array(loop.controller.gains)  # type: ignore[union-attr]
        assert gains.shape[2] == inputs
        moved.append(np.einsum("nm,pjmk->pjnk", np.array(B), gains))
    np.testing.assert_allclose(moved[1], moved[0], atol=1e-6 * np.abs(moved[0]).max())
