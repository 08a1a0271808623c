"""A table of signals over time that another program wrote as CSV."""

from __future__ import annotations

import csv
import io
import math
import os
from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hil.errors import HilError
from hil.files.regular import open_regular

MOST_BYTES = 256 << 20
TIME_COLUMNS = {"t_s": 1.0, "t_ns": 1e-9, "time": 1.0, "t": 1.0}
JITTER = 0.01
"""Largest deviation of an instant from a whole number of periods, in periods."""


def read_signal_table(path: str | Path, names: Sequence[str]) -> tuple[float, npt.NDArray[np.float64]]:
    """Return the sample period in s and columns (n, len(names)) over consecutive slots, NaN where nothing was recorded.

    The first line names the columns, with units in brackets or without; the time stands in `t_s`, `t_ns`, `time` or `t`.

    Args:
        path: the file.
        names: columns to be read.

    Raises:
        HilError: it cannot be read, a column is missing, an entry is no number, or the instants are no multiples of a period;
            the message has the line.
    """
    numbers = array("d")  # a float in a list takes four times as much
    with open_regular(path, "a table of signals") as file:
        if os.fstat(file.fileno()).st_size > MOST_BYTES:
            raise HilError(f"{path}: more than {MOST_BYTES} bytes, the limit of a table of signals")
        try:
            lines = csv.reader(io.TextIOWrapper(file, "utf-8-sig", newline=""), strict=True)
            header = [name.split("[")[0].strip() for name in next(lines, [])]
            clock = next((name for name in TIME_COLUMNS if name in header), None)
            if clock is None:
                raise HilError(f"{path}: no column of times, expected one of {', '.join(TIME_COLUMNS)}")
            for name in names:
                if name not in header:
                    raise HilError(f"{path}: no column {name!r}; it has {', '.join(header)[:200]}")
            picked = [header.index(name) for name in (clock, *names)]
            for line in lines:
                if not line:
                    continue
                if len(line) != len(header):
                    raise HilError(f"{path}:{lines.line_num}: {len(line)} entries, the first line has {len(header)}")
                try:
                    numbers.extend([float(line[i]) if line[i].strip() else math.nan for i in picked])
                except ValueError:
                    raise HilError(f"{path}:{lines.line_num}: {','.join(line)[:80]!r} is not all numbers") from None
        except (OSError, UnicodeDecodeError, csv.Error) as e:
            raise HilError(f"{path}: is no CSV: {e}") from e
    table = np.frombuffer(numbers).reshape(-1, len(picked))
    if len(table) < 2:
        raise HilError(f"{path}: {len(table)} rows, expected at least 2")
    return _slotted(path, table[:, 0] * TIME_COLUMNS[clock], table[:, 1:])


def _slotted(
    path: str | Path, t: npt.NDArray[np.float64], values: npt.NDArray[np.float64]
) -> tuple[float, npt.NDArray[np.float64]]:
    steps = np.diff(t)
    if not (np.isfinite(t).all() and steps.min() > 0.0):
        at = int(np.flatnonzero(~(steps > 0.0))[0]) if (~(steps > 0.0)).any() else 0
        raise HilError(f"{path}: row {at + 2}: the time does not grow")
    period_s = float(np.median(steps))
    slots = np.rint((t - t[0]) / period_s)
    if slots[-1] > 4 * len(t):
        raise HilError(f"{path}: {len(t)} rows over {slots[-1]:.0f} periods of {period_s:g} s; expected no such gaps")
    if slots[-1] > 0.0:  # the median of rounded instants drifts over a long table
        period_s = float((t[-1] - t[0]) / slots[-1])
    off = np.abs((t - t[0]) / period_s - slots)
    if off.max() > JITTER or (np.diff(slots) < 1).any():
        at = int(off.argmax())
        raise HilError(f"{path}: row {at + 1}: {t[at]:.9g} s is {off[at]:.3g} periods off a multiple of {period_s:g} s")
    out = np.full((int(slots[-1]) + 1, values.shape[1]), math.nan)
    out[slots.astype(np.int64)] = values
    return period_s, out
