"""The port of a device: the force that its motor puts out, the position that it acts on, and what resists there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from hil.plugins.protocols import JumpPlant, Plant

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
