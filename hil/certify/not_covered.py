"""Why no certificate covers a controller or a plant: which part, what it lacks, and what would be judged."""

from __future__ import annotations

import numpy as np

from design.controllers import LoopModel
from hil.plugins.protocols import JumpPlant, Plant

STATES = {
    "table(model)": ("table", "selection"),
    "linear_law(model)": ("linear_law",),
    "laws_of_ages(model, ages)": ("laws_of_ages",),
    "schedule_of_modes()": ("schedule_of_modes",),
    "history()": ("history", "uses"),
    "wall, coupler and equalise": ("wall", "coupler", "equalise"),
}
"""What a controller may state of itself, and the attributes that it takes."""


def why_no_controller(controller: object) -> str:
    """Return why a controller that states nothing of itself is not judged, and what it may state.

    Args:
        controller: the parameters of the controller that runs.
    """
    own = type(controller).__qualname__
    for said, names in STATES.items():
        lacks = [name for name in names if not hasattr(controller, name)]
        if 0 < len(lacks) < len(names) and hasattr(controller, names[0]):
            return f"[controller] {own} has {said} and lacks {' and '.join(lacks)}: with both its loop would be judged"
    return (
        f"[controller] {own} states no gains or matrices, and no proof knows what it answers: it has none of "
        f"{', '.join(STATES)}; state table(model) of a gain without a state, linear_law(model) of a linear one with states, "
        'or take kind = "output-feedback" with its A, B, C, D'
    )


def jumping(plant: Plant, what: str) -> str:
    """Return why a controller that knows no modes is not judged over a plant that jumps."""
    return (
        f"[plant] {type(plant).__qualname__} jumps between modes, and no proof covers {what} over it; gains by mode are judged "
        '(schedule_of_modes(); kind = "scheduled")'
    )


def why_no_history(plant: Plant, model: LoopModel) -> str:
    """Return why gains over historical data are not judged over a plant that jumps, or whose outputs are not its states.

    Args:
        plant: the plant.
        model: of the plant, at the period of the loop.
    """
    own = type(plant).__qualname__
    if isinstance(plant, JumpPlant):
        return (
            f"[plant] {own} jumps between modes, and gains over historical data are judged over one set of matrices; over modes "
            'gains by mode are judged (schedule_of_modes(); kind = "scheduled")'
        )
    p, n = model.C.shape
    outputs, states = [str(s.name) for s in plant.outputs], [str(s.name) for s in plant.states]
    missing = [name for name in states if name not in outputs]
    if len(states) == n and missing:
        cause = f"it does not measure {', '.join(missing)}"
    else:
        cause = f"its {p} outputs are {np.array2string(np.asarray(model.C), precision=4, separator=', ')} times its {n} states"
    return (
        f"[plant] {own}: {cause}, and gains over historical data are judged where the outputs are the states, one by one and in "
        "their order (C the unit matrix); over other outputs a table of gains or output feedback is judged"
    ).replace("\n", "")
