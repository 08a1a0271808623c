"""What a log or a table holds of one axis: the input that acted and the output that was measured, slot by slot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.errors import HilError
from hil.log.read.foreign_logs import read_signal_table
from hil.log.read.run import read_run
from hil.log.run import Run
from hil.measure.view import APPLIED, MEASUREMENT, view_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One axis y'' + p y' = g u of a plant that can be identified.

    Args:
        input, output: names of the signals.
        parameters: names in the plant's table: of m and b, or of g and p.
        physical: whether these are m = 1/g and b = p/g.
    """

    input: str
    output: str
    parameters: tuple[str, str]
    physical: bool


AXES = {
    "omni": Axis(input="torque", output="angle", parameters=("inertia", "damping"), physical=True),
    "dc-motor": Axis(input="voltage", output="angle", parameters=("gain", "pole"), physical=False),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisRecord:
    """One file.

    Args:
        path: the file.
        period_s: T in s.
        u: input (n,), disturbances of the experiment included.
        y: output (n,), NaN where it is missing.
        plant: table `plant` of the experiment that was logged, empty for a table of signals.
    """

    path: str
    period_s: float
    u: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    plant: dict[str, Any]


def read_axis_record(path: Path, kind: str | None, names: tuple[str | None, str | None]) -> AxisRecord:
    """Return what a file holds of an axis.

    Args:
        path: a log (.mcap) or a table of signals (.csv).
        kind: the plant; None takes it from the log.
        names: input and output, None for those of the plant.

    Raises:
        HilError: it cannot be read, the plant is no axis, or a signal is missing.
    """
    if path.suffix.lower() == ".csv":
        if kind is None:
            raise HilError(f"{path}: a table does not name its plant; add --plant {' or '.join(AXES)}")
        wanted = _names(kind, names)
        period_s, columns = read_signal_table(path, wanted)
        if not math.isfinite(columns[-1, 0]):
            columns = columns[:-1]  # the last measurement has no input behind it
        return AxisRecord(path=str(path), period_s=period_s, u=columns[:, 0], y=columns[:, 1], plant={})
    run = read_run(path)
    plant = dict(run.resolved.get("plant", {}))
    logged = str(plant.get("kind", ""))
    if kind is None:
        if logged not in AXES:
            raise HilError(f"{path}: plant {logged or 'unknown'!r} is no axis y'' + p y' = g u; expected {' or '.join(AXES)}")
        kind = logged
    return _of_run(path, run, plant, *_names(kind, names))


def _names(kind: str, names: tuple[str | None, str | None]) -> tuple[str, str]:
    axis = AXES[kind]
    return names[0] or axis.input, names[1] or axis.output


def _of_run(path: Path, run: Run, plant: dict[str, Any], u_name: str, y_name: str) -> AxisRecord:
    applied, measured = run.arrays[APPLIED], run.arrays[MEASUREMENT]
    for topic, array, name in ((APPLIED, applied, u_name), (MEASUREMENT, measured, y_name)):
        if name not in (array.dtype.names or ()):
            known = ", ".join(f.name for f in run.schemas[topic].fields if f.type == "float64")
            raise HilError(f"{path}: topic {topic} has no signal {name!r}; it has {known}")
    if not len(applied) or not len(measured):
        raise HilError(f"{path}: holds no slot")
    first, slots = int(applied["tick"][0]), int(applied["tick"][-1]) - int(applied["tick"][0]) + 1
    if slots != len(applied) or (np.diff(applied["tick"]) != 1).any():
        last = int(applied["tick"][int(np.flatnonzero(np.diff(applied["tick"]) != 1)[0])])
        raise HilError(f"{path}: the input after slot {last} is missing; a fit needs every input")
    u = np.asarray(applied[u_name], dtype=np.float64)
    if f"w_{u_name}" in (applied.dtype.names or ()):
        u = u + applied[f"w_{u_name}"]
    y = np.full(slots, math.nan)
    row = measured["tick"] - first
    kept = (row >= 0) & (row < slots)
    y[row[kept]] = measured[y_name][kept]
    return AxisRecord(path=str(path), period_s=view_of(run).period_s, u=u, y=y, plant=plant)
