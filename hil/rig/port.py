"""What is taken of a plant: its port, and the matrices by which it moves.

The port of a device: the force that its motor puts out, the position that it acts on, and what resists there.

By which matrices a plant moves, where a designer sees others: what theory computes with, beside what controllers know.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from design.controllers import LoopModel
from hil.plugins.protocols import JumpPlant, MovesOtherwise, Plant

CONJUGATE: Final = (("N", "m"), ("N m", "rad"))
"""Units of an input and an output whose product is energy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Port:
    """A device under one force: mass x'' + damping x' + stiffness x = force.

    Args:
        mass: in the unit of force per acceleration.
        damping: what damping takes, per speed.
        stiffness: of a spring to rest, at least 0; per length.
        output: index of the output that is the position, None if none of them is it.
    """

    mass: float
    damping: float
    stiffness: float
    output: int | None


def port_of(plant: Plant) -> Port | None:
    """Return the port of a plant with the state (position, speed) and one input, read from its model; None for others.

    Args:
        plant: any plant.
    """
    model = plant.model()
    if isinstance(plant, JumpPlant) or model.A.shape != (2, 2) or model.B.shape != (2, 1) or model.A[0].tolist() != [0.0, 1.0]:
        return None
    mass = 1.0 / float(model.B[1, 0])
    force, pairs = plant.inputs[0].unit, zip(model.C.tolist(), plant.outputs)
    found = [i for i, (row, y) in enumerate(pairs) if row == [1.0, 0.0] and (force, y.unit) in CONJUGATE]
    return Port(
        mass=mass,
        damping=-float(model.A[1, 1]) * mass,
        stiffness=max(-float(model.A[1, 0]) * mass, 0.0),
        output=found[0] if found else None,
    )


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
