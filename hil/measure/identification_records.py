"""What `hil identify` reads of a log or a table, slot by slot: input and output of an axis; a fault and its detection."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.identification.jump_rates import ModeRecord
from hil.errors import HilError
from hil.files.arrays import read_columns
from hil.log.read import read_run
from hil.log.run import Run
from hil.log.topics import STATE
from hil.measure.view import APPLIED, MEASUREMENT, view_of


class Axis(Struct, frozen=True, kw_only=True):
    """One axis y'' + p y' = g u of a plant that can be identified.

    Args:
        input, output: names of the signals.
        parameters: names in the plant's table, with their units: of m and b, or of g and p.
        physical: whether these are m = 1/g and b = p/g.
        unit: of the input.
    """

    input: str
    output: str
    parameters: Mapping[str, str]
    physical: bool
    unit: str


AXES = {
    "omni": Axis(
        input="torque", output="angle", parameters={"inertia": "kg m²", "damping": "N m s/rad"}, physical=True, unit="N m"
    ),
    "dc-motor": Axis(input="voltage", output="angle", parameters={"gain": "rad/(V s²)", "pole": "1/s"}, physical=False, unit="V"),
}


class AxisRecord(Struct, frozen=True, kw_only=True):
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
        if not path.exists():
            raise HilError(f"{path}: cannot be read: No such file or directory")
        if kind is None:
            raise HilError(f"{path}: a table does not name its plant; add --plant {' or '.join(AXES)}")
        wanted = _names(kind, names)
        period_s, columns = read_signal_table(path, wanted, (AXES[kind].unit, "rad"))
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
            raise HilError(f"{path}: topic {topic} has no signal {name!r}; it has {', '.join(run.schemas[topic].floats)}")
    if not len(applied) or not len(measured):
        raise HilError(f"{path}: holds no slot")
    first, slots = int(applied["slot"][0]), int(applied["slot"][-1]) - int(applied["slot"][0]) + 1
    if slots != len(applied) or (np.diff(applied["slot"]) != 1).any():
        last = int(applied["slot"][int(np.flatnonzero(np.diff(applied["slot"]) != 1)[0])])
        raise HilError(f"{path}: the input after slot {last} is missing; a fit needs every input")
    u = np.asarray(applied[u_name], dtype=np.float64)
    if f"w_{u_name}" in (applied.dtype.names or ()):
        u = u + applied[f"w_{u_name}"]
    y = np.full(slots, math.nan)
    row = measured["slot"] - first
    kept = (row >= 0) & (row < slots)
    y[row[kept]] = measured[y_name][kept]
    return AxisRecord(path=str(path), period_s=view_of(run).period_s, u=u, y=y, plant=plant)


TIME_COLUMNS = {"t_s": 1.0, "t_ns": 1e-9, "time": 1.0, "t": 1.0}
JITTER = 0.01
"""Largest deviation of an instant from a whole number of periods, in periods."""


def read_signal_table(
    path: str | Path, names: Sequence[str], units: Sequence[str] = ()
) -> tuple[float, npt.NDArray[np.float64]]:  # fmt: skip
    """Return the sample period in s and columns (n, len(names)) over consecutive slots, NaN where nothing was recorded.

    The first line names the columns, with units in brackets or without; the time stands in `t_s`, `t_ns`, `time` or `t`.

    Args:
        path: the file.
        names: columns to be read.
        units: what they are in; by default anything.

    Raises:
        HilError: it cannot be read, a column is missing or in another unit, an entry is no number, or the instants are no
            multiples of a period; the message has the line.
    """
    clock = ""

    def picked(header: list[str]) -> list[str]:
        nonlocal clock
        clock = next((name for name in TIME_COLUMNS if name in header), "")
        if not clock:
            raise HilError(f"{path}: no column of times, expected one of {', '.join(TIME_COLUMNS)}")
        for name in names:
            if name not in header:
                raise HilError(f"{path}: no column {name!r}; it has {', '.join(header)[:200]}")
        return [clock, *names]

    _, table, _, said = read_columns(Path(path), "a table of signals", picked)
    for name, unit, wanted in zip((clock, *names), said, ("ns" if clock == "t_ns" else "s", *units)):
        if unit and _plain(unit) != _plain(wanted):
            raise HilError(f"{path}: {name} is in {unit!r:.40}, expected {wanted}")
    if len(table) < 2:
        raise HilError(f"{path}: {len(table)} rows, expected at least 2")
    return _slotted(path, table[:, 0] * TIME_COLUMNS[clock], table[:, 1:])


def _plain(unit: str) -> str:
    return re.sub(r"[ ·*.]", "", unit)


def _slotted(
    path: str | Path, t: npt.NDArray[np.float64], values: npt.NDArray[np.float64]
) -> tuple[float, npt.NDArray[np.float64]]:
    steps = np.diff(t)
    wrong = ~((steps > 0.0) & np.isfinite(steps))
    if wrong.any():
        raise HilError(f"{path}: row {wrong.argmax() + 2}: the time does not grow, or is infinite")
    period_s = float(np.median(steps))
    slots = np.concatenate(([0.0], np.cumsum(np.rint(steps / period_s))))  # from t[0] on the median's error would add up
    if slots[-1] > 4 * len(t):
        raise HilError(f"{path}: {len(t)} rows over {slots[-1]:.0f} periods of {period_s:g} s; expected no such gaps")
    if slots[-1] > 0.0:
        period_s = float((t[-1] - t[0]) / slots[-1])
    off = np.abs((t - t[0]) / period_s - slots)
    if off.max() > JITTER or (np.diff(slots) < 1).any():
        at = int(off.argmax())
        raise HilError(
            f"{path}: row {at + 1}: {t[at]:.9g} s is {off[at]:.3g} periods off a multiple of {period_s:g} s, expected up to "
            f"{JITTER:g}; where a timer paces the device and its clock was read late, write k times its period"
        )
    out = np.full((int(slots[-1]) + 1, values.shape[1]), math.nan)
    out[slots.astype(np.int64)] = values
    return period_s, out


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
            known = ", ".join(run.schemas[STATE.name].floats)
            raise HilError(f"{path}: {STATE.name} has no mode {name!r}, as a log of vtol-fault has; it has {known}")
    gaps = np.flatnonzero(np.diff(table["slot"]) != 1)
    if gaps.size:
        raise HilError(f"{path}: the modes after slot {int(table['slot'][gaps[0]])} are missing; a rate needs every slot")
    fault, detected = (_modes(path, name, np.asarray(table[name], dtype=np.float64)) for name in names)
    restarts = bool(run.resolved.get("plant", {}).get("failure_restarts_detection_clock", False))
    return ModeRecord(fault, detected, view_of(run).period_s), restarts


def _modes(path: Path, name: str, values: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    whole = np.isfinite(values).all() and (values == np.round(values)).all()
    if not (whole and values.min() >= 1 and values.max() <= MOST_MODES):
        raise HilError(f"{path}: {STATE.name}: {name} is no mode, expected whole numbers from 1 to {MOST_MODES}")
    return values.astype(np.int64)
