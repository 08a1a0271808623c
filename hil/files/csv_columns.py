"""Columns of numbers of a CSV file that another program wrote."""

from __future__ import annotations

import csv
import io
import math
import os
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.errors import HilError
from hil.files.regular import open_regular

MOST_BYTES = 256 << 20
MISSING = ("", "lost", "nan")


class Columns(NamedTuple):
    """What was read.

    Attributes:
        header: names of all columns, without their units.
        values: the columns that were picked, (rows, columns), NaN where an entry is missing.
        lines: of every row the line of the file, counted from 1.
    """

    header: list[str]
    values: NDArray[np.float64]
    lines: NDArray[np.int64]


def read_columns(path: Path, what: str, picked: Callable[[list[str]], Sequence[str]]) -> Columns:
    """Read columns of a file whose first line names them, with units in brackets or without. Lines that begin with # are skipped.

    Args:
        path: the file.
        what: what the file is, for messages.
        picked: the names of the columns to be read, from those that the file has.

    Raises:
        HilError: it cannot be read, is larger than `MOST_BYTES`, a row has another length than the first line, or an entry is
            no number; the message has the line.
    """
    numbers, lines = array("d"), array("q")  # a float in a list takes four times as much
    with open_regular(path, what) as file:
        if os.fstat(file.fileno()).st_size > MOST_BYTES:
            raise HilError(f"{path}: more than {MOST_BYTES} bytes, the limit of {what}")
        try:
            rows = csv.reader(io.TextIOWrapper(file, "utf-8-sig", newline=""), strict=True)
            header = [name.split("[")[0].strip() for name in next(rows, [])]
            at = [header.index(name) for name in picked(header)]
            for row in rows:
                if not row or row[0].lstrip().startswith("#"):
                    continue
                if len(row) != len(header):
                    raise HilError(f"{path}:{rows.line_num}: {len(row)} entries, the first line has {len(header)}")
                lines.append(rows.line_num)
                for i in at:
                    try:
                        numbers.append(math.nan if row[i].strip().lower() in MISSING else float(row[i]))
                    except ValueError:
                        raise HilError(f"{path}:{rows.line_num}: {row[i]!r:.40} is no number") from None
        except (OSError, UnicodeDecodeError, csv.Error) as e:
            raise HilError(f"{path}: is no CSV: {e}") from e
    return Columns(header, np.frombuffer(numbers).reshape(len(lines), len(at)), np.frombuffer(lines, np.int64))
