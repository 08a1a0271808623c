"""Which changes a run in real time takes. Written here alone: page, script and guide ask it."""

from __future__ import annotations

from typing import Final

from hil.compose.changed import PLANT, REPLACED, SCHEDULES
from hil.compose.loop import Loop
from hil.errors import ExperimentError
from hil.plugins.protocols import GoesOn

IN_REAL_TIME: Final = (*SCHEDULES, "fault", *(name for name in REPLACED if name.startswith("network.")))
"""What the rig emulates and draws; a restart of the controller among the faults kills its process and starts another.

Of the plant: what only leads it from within, by `GoesOn.own_way`.
"""

IN_ITS_PROCESS: Final = "the controller is a process of its own, which was started with its parameters"
TABULATED: Final = "the plant tabulates other equations anew, which may take longer than a slot"


def refuse_in_real_time(loop: Loop, path: str) -> None:
    """Refuse a change that a run in real time does not take.

    Args:
        loop: what runs.
        path: of the field, see `hil.compose.changed.changed`.

    Raises:
        ExperimentError: with the reason, and with what is taken.
    """
    plant = loop.experiment.plant
    led = tuple(PLANT + name for name in plant.own_way()) if isinstance(plant, GoesOn) else ()
    taken = (*IN_REAL_TIME, *led)
    if any(f"{path}.".startswith(f"{name}.") for name in taken):
        return
    if path.startswith("controller"):
        why = IN_ITS_PROCESS
    elif path.startswith(PLANT):
        why = TABULATED
    else:
        why = "its processes were started with it"
    message = f"{path}: does not change in real time: {why} (what does: {', '.join(taken)}); in virtual time it may"
    raise ExperimentError(loop.experiment.name, [message])
