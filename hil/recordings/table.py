"""A table of packets (.csv): latencies, round trips, or the time stamps of both ends.

| columns | what they are |
|---|---|
| `latency_s` or `latency_ms` | one direction; with `sent_s` beside it where there is one |
| `rtt_s` or `rtt_ms` | round trips; likewise |
| `sent_s`, `received_s` | instants at the clocks of both ends |

A packet that was lost has an empty entry, `lost` or `nan`. Without `sent_s` the file has one line for every packet, in order.
"""

from __future__ import annotations

import csv
import io
import math
import os
from array import array
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import HilError
from hil.files.regular import open_regular
from hil.recordings.recording import ROUND_TRIP, THERE, Recording, Way

Array = NDArray[np.float64]

MOST_BYTES = 256 << 20
VALUES = {"latency_s": (THERE, 1.0), "latency_ms": (THERE, 1e-3), "rtt_s": (ROUND_TRIP, 1.0), "rtt_ms": (ROUND_TRIP, 1e-3)}
NOMINAL_S = 1.0
"""Time between packets of a table that does not say when they were sent."""


def read_latencies(path: Path, *, one_clock: bool = False) -> Recording:
    """Read a table.

    Args:
        path: the file.
        one_clock: `sent_s` and `received_s` are of one clock.

    Raises:
        HilError: names the file, the line and what was expected.
    """
    columns, lines = _columns(path)
    value = next((name for name in VALUES if name in columns), None)
    sent = columns.get("sent_s")
    if sent is not None and np.isnan(sent).any():
        raise HilError(f"{path}:{lines[int(np.isnan(sent).argmax())]}: sent_s: missing, expected the instant of every packet")
    if sent is not None and len(back := np.flatnonzero(np.diff(sent) < 0.0)):
        at = int(back[0]) + 1
        raise HilError(f"{path}:{lines[at]}: sent_s: {sent[at]:.9g} follows {sent[at - 1]:.9g}: time stamps run backwards")
    if value is not None:
        name, unit = VALUES[value]
        found = columns[value] * unit
        wrong = np.flatnonzero(found < 0.0)
        if len(wrong):
            at = int(wrong[0])
            raise HilError(f"{path}:{lines[at]}: {value}: {columns[value][at]:.9g} is negative, expected a latency >= 0")
        notes = () if sent is not None else (f"{path}: no column sent_s: the lines are taken as packets in order, one a slot",)
        instants = sent if sent is not None else np.arange(len(found), dtype=np.float64) * NOMINAL_S
        return Recording(source=str(path), ways={name: Way(sent_s=instants, difference_s=found)}, clocks=1, notes=notes)
    if sent is None or "received_s" not in columns:
        known = f"{', '.join(VALUES)}, or sent_s and received_s"
        raise HilError(f"{path}: the first line names no column of latencies: {', '.join(columns)[:200]!r}; expected {known}")
    way = Way(sent_s=sent, difference_s=columns["received_s"] - sent)
    wrong = np.flatnonzero(way.difference_s < 0.0)
    if one_clock and len(wrong):
        at = int(wrong[0])
        raise HilError(
            f"{path}:{lines[at]}: received_s lies {-way.difference_s[at]:.6g} s before sent_s, of one clock (--one-clock)"
        )
    return Recording(source=str(path), ways={THERE: way}, clocks=1 if one_clock else 2)


def _columns(path: Path) -> tuple[dict[str, Array], list[int]]:
    with open_regular(path, "a table of packets") as file:
        if os.fstat(file.fileno()).st_size > MOST_BYTES:
            raise HilError(f"{path}: more than {MOST_BYTES} bytes, the limit of a table of packets")
        try:
            rows = csv.reader(io.TextIOWrapper(file, "utf-8-sig", newline=""), strict=True)
            header = [name.split("[")[0].strip() for name in next(rows, [])]
            wanted = [name for name in header if name in (*VALUES, "sent_s", "received_s")]
            picked, numbers, lines = [header.index(name) for name in wanted], array("d"), []
            for row in rows:
                if not row or row[0].lstrip().startswith("#"):
                    continue
                if len(row) != len(header):
                    raise HilError(f"{path}:{rows.line_num}: {len(row)} entries, the first line has {len(header)}")
                lines.append(rows.line_num)
                numbers.extend(_number(path, rows.line_num, row[i]) for i in picked)
        except (UnicodeDecodeError, csv.Error) as error:
            raise HilError(f"{path}: is no CSV text: {error}") from error
    table = np.array(numbers).reshape(len(lines), len(wanted))
    return dict.fromkeys(header, np.empty(0)) | {name: table[:, i] for i, name in enumerate(wanted)}, lines


def _number(path: Path, line: int, text: str) -> float:
    word = text.strip().lower()
    if word in ("", "lost", "nan"):
        return math.nan
    try:
        value = float(word)
    except ValueError:
        value = math.inf
    if not math.isfinite(value):
        raise HilError(f"{path}:{line}: {text!r:.40} is no number, expected one, or nothing of a packet that was lost")
    return value
