"""By which matrices a plant moves, where a designer sees others: what theory computes with, beside what controllers know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from design.controllers import LoopModel
from hil.plugins.protocols import MovesOtherwise, Plant


def motion_of(plant: Plant, model: LoopModel) -> LoopModel:
    """Return the loop's model with the matrices by which the plant moves; the model itself where these are what a designer sees.

    Args:
        plant: what runs.
        model: what controllers know of it.
    """
    if not isinstance(plant, MovesOtherwise):
        return model
    moves = plant.motion().discretise(model.period_s)
    return replace(model, A=np.asarray(moves.A), B=np.asarray(moves.B), C=np.asarray(moves.C))
