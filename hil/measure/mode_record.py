"""What a log holds of a fault and of its detection: both modes, slot by slot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from design.identification.jump_rates import ModeRecord
from hil.errors import HilError
from hil.log.read.run import read_run
from hil.log.topics import STATE
from hil.measure.view import view_of

FAULT, DETECTED = "fault_mode", "detected_mode"
MOST_MODES = 100


def read_mode_record(path: Path, names: tuple[str, str] = (FAULT, DETECTED)) -> tuple[ModeRecord, bool]:
    """Return the modes of a log, and whether its plant's jumps of the fault restart the sojourn of the detected mode.

    Args:
        path: a log (.mcap).
        names: states that are the true and the detected mode.

    Raises:
        HilError: it cannot be read, has no such states, or slots are missing.
    """
    run = read_run(path)
    table = run.arrays.get(STATE.name)
    if table is None or not len(table):
        raise HilError(f"{path}: holds no slot of {STATE.name}, which has the modes")
    for name in names:
        if name not in (table.dtype.names or ()):
            known = ", ".join(field.name for field in run.schemas[STATE.name].fields if field.type == "float64")
            raise HilError(f"{path}: {STATE.name} has no mode {name!r}, as a log of vtol-fault has; it has {known}")
    gaps = np.flatnonzero(np.diff(table["tick"]) != 1)
    if gaps.size:
        raise HilError(f"{path}: the modes after slot {int(table['tick'][gaps[0]])} are missing; a rate needs every slot")
    fault, detected = (_modes(path, name, np.asarray(table[name], dtype=np.float64)) for name in names)
    restarts = bool(run.resolved.get("plant", {}).get("failure_restarts_detection_clock", False))
    return ModeRecord(fault, detected, view_of(run).period_s), restarts


def _modes(path: Path, name: str, values: NDArray[np.float64]) -> NDArray[np.int64]:
    whole = np.isfinite(values).all() and (values == np.round(values)).all()
    if not (whole and values.min() >= 1 and values.max() <= MOST_MODES):
        raise HilError(f"{path}: {STATE.name}: {name} is no mode, expected whole numbers from 1 to {MOST_MODES}")
    return values.astype(np.int64)
