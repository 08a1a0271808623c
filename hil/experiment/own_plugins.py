"""What a plant or a controller of somebody's own has to be before it runs, told in one sentence instead of a traceback."""

from __future__ import annotations

import traceback

from design.controllers import Controller
from hil.experiment.plugins import Group
from hil.experiment.protocols import Designer, Plant
from plants.errors import PlantError
from plants.parts.check import check_plant


def own_fault(group: Group, made: object) -> str | None:
    """Return why an object is no plant, or no controller, that a rig can run; None if it is one, or something else is asked for.

    Args:
        group: what it has to be.
        made: of a class of the user's own.
    """
    checks = {"hil.plants": own_plant_fault, "hil.controllers": own_controller_fault}
    return checks[group](made) if group in checks else None


def own_plant_fault(made: object) -> str | None:
    """Return why an object is no plant that a rig can run, None if it is one.

    Args:
        made: of a class of the user's own.
    """
    if not isinstance(made, Plant):
        return f"is no plant: {_lacking(made, ('inputs', 'outputs', 'states', 'model', 'start'))}"
    try:
        check_plant(made)
    except PlantError as error:
        return f"check_plant: {error}"
    except Exception as error:  # whatever a stranger's plant does when it runs
        return f"check_plant: {words(error)}"
    return None


def own_controller_fault(made: object) -> str | None:
    """Return why an object is no controller, None if it is one.

    Args:
        made: of a class of the user's own.
    """
    if isinstance(made, Controller | Designer):
        return None
    return f"is no controller: {_lacking(made, ('start',))}"


def words(error: Exception) -> str:
    """Return what an exception of the user's own code says, with the line that raised it.

    Args:
        error: as it was caught.
    """
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def _lacking(made: object, wanted: tuple[str, ...]) -> str:
    there = dir(made)
    return f"{type(made).__qualname__} lacks {', '.join(name for name in wanted if name not in there)}"
