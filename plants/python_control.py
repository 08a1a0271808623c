"""Plants from and to python-control, which only these functions import: no loop does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from plants.errors import PlantError
from plants.parts.control_package import python_control
from plants.parts.linear import DiscreteStateSpace, Signal, StateSpace
from plants.parts.protocols import Plant
from plants.state_space import LinearPlant

if TYPE_CHECKING:
    import control


def from_control(
    system: control.StateSpace | control.TransferFunction,
    *,
    inputs: Sequence[Signal] = (),
    outputs: Sequence[Signal] = (),
    states: Sequence[Signal] = (),
    initial_state: Sequence[float] = (),
) -> LinearPlant:
    """Return the plant that a python-control model describes.

    Args:
        system: continuous time, strictly proper: a rig measures y(k) before u(k) exists. A transfer function is realised.
        inputs, outputs, states: names and units; see `LinearPlant`.
        initial_state: x at time 0, n entries; zero if left out.

    Raises:
        PlantError: for a model in discrete time, with a direct feedthrough, or without a state.
    """
    model = python_control().ss(system)
    if model.isdtime(strict=True):
        raise PlantError(f"from_control: the model has the period {model.dt}; a rig moves a plant in continuous time")
    if np.any(model.D):
        raise PlantError("from_control: D is not zero; a rig measures y(k) before u(k) exists")
    if not model.nstates:
        raise PlantError("from_control: the model has no state; a fixed gain is a controller")
    A, B, C = (tuple(tuple(map(float, row)) for row in np.asarray(M)) for M in (model.A, model.B, model.C))
    return LinearPlant(
        A=A, B=B, C=C, inputs=tuple(inputs), outputs=tuple(outputs), states=tuple(states), initial_state=tuple(initial_state)
    )


def to_control(plant: Plant | StateSpace | DiscreteStateSpace) -> control.StateSpace:
    """Return the linear model of a plant, or a model, as a `control.StateSpace`, with the names of its signals.

    Args:
        plant: a plant, whose model is taken, or a model in continuous or discrete time.
    """
    if isinstance(plant, StateSpace | DiscreteStateSpace):
        return plant.to_control()
    model = plant.model().to_control()
    model.set_inputs([s.name for s in plant.inputs])
    model.set_outputs([s.name for s in plant.outputs])
    if model.nstates == len(plant.states):
        model.set_states([s.name for s in plant.states])
    return model
