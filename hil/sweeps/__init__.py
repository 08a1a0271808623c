"""Many runs of one experiment: seeds, records of what ran.

Here is what a sweep has found: the numbers of its runs, in its file and for a notebook. The file has one line per finished run,
so that a sweep that was interrupted goes on where it was.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.monte_carlo.confidence import Interval
from hil.errors import HilError, located
from hil.experiment import Experiment
from hil.measure import Quantity
from hil.measure.signals import with_unit
from hil.notebook import Result
from hil.rig.loop import Loop, digest_of
from hil.sweeps.shown import (
    ShownResult,
    Values,
    asked,
    interval_of,
    mean_and_interval,
    paint_distributions,
    stopped_in_words,
    within,
)

HEADS = ("quantity", "runs", "mean", "95 % interval", "sd", "5 %", "50 %", "95 %")


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Sweep(ShownResult):
    """What a sweep has found.

    Args:
        values: ``seed``, ``stopped`` and every metric, one entry per run in the order of the seeds.
        interrupted: 130 if Ctrl-C came (143 if SIGTERM did), else 0; the values are those of the runs that were done.
        interval, reached: with a stopping rule, its interval (None before the first look) and whether it is narrow enough.
        caution: what is to be said beside the numbers, nothing where all is well: the loop is not certified, the first run
            withdrew the certificate, or a mean of squared errors does not converge; see `hil.compose.judged`.
        alone: which measures kept the runs from being computed at once, nothing where none did.
        experiment, quantities: its name, and what it measures.
    """

    values: Mapping[str, NDArray[np.float64]]
    interrupted: int
    interval: Interval | None = None
    reached: bool = False
    caution: str = ""
    alone: str = ""
    experiment: str = ""
    quantities: tuple[Quantity, ...] = ()

    def _runs(self) -> tuple[Mapping[str, Sequence[str]], Sequence[Values]]:
        return {}, [self.values]

    def _result(self, quantity: str | None = None) -> Result:
        of = asked(self.quantities, quantity, [self.values])
        value_text = f"{mean_and_interval(self.values[of.name], of)}; {stopped_in_words(self.values)}"
        paint = paint_distributions({self.experiment: self.values}, of)
        answer = [value_text, *filter(None, [self.caution])]
        return Result(line=repr(self)[1:-1], answer=answer, columns=HEADS, rows=self.rows(), paint=paint)

    def rows(self) -> list[list[Any]]:
        """Return a row per quantity, as `HEADS` names its columns."""
        found = []
        for each in self.quantities:
            s, inner = statistics(self.values[each.name]), within(interval_of(self.values[each.name]))
            shares = (s["percentiles"].get(p) for p in ("5", "50", "95"))
            found.append([with_unit(each.title, each.unit), s["n"], s["mean"], inner, s["sd"], *shares])
        return found

    def __repr__(self) -> str:
        of, runs = asked(self.quantities, None, [self.values]), self.values["seed"].size
        value_text = mean_and_interval(self.values[of.name], of)
        return f"<Sweep {self.experiment}: {runs} runs, {value_text}, {stopped_in_words(self.values)}>"


def statistics(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return mean, standard deviation, standard error and percentiles of one metric over the runs that have it.

    One run has no deviation, and equal ones have 0.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return {"n": 0, "mean": None, "sd": None, "se": None, "percentiles": {}}
    sd = None if finite.size == 1 else float(finite.std(ddof=1)) if np.ptp(finite) > 0.0 else 0.0
    points = (1, 5, 25, 50, 75, 95, 99)
    return {
        "n": int(finite.size),
        "mean": float(finite.mean()),
        "sd": sd,
        "se": None if sd is None else sd / float(np.sqrt(finite.size)),
        "percentiles": {str(p): float(v) for p, v in zip(points, np.percentile(finite, points))},
    }


FORMAT = "hil-sweep/1"
LONGEST_LINE = 1_000_000  # bytes; a row has some two hundred


class SweepStore:
    """Rows of metrics by seed, in a text file of JSON lines that is complete after every row.

    The first line says which experiment the rows belong to; a file of another one is refused. A last line that was torn
    by a crash is cut off. The file is locked, so that two sweeps cannot mix their rows.

    Args:
        path: the file; made if it is not there.
        experiment: what the rows belong to; its own seed does not matter.
        metrics: columns of a row, besides ``seed``.
        loop: of the experiment: with other gains, of a file that the experiment names or solved anew, the rows belong to another.

    Raises:
        HilError: if the file belongs to something else, is in use, or cannot be written.
    """

    def __init__(self, path: Path, experiment: Experiment, metrics: Sequence[str], loop: Loop | None = None) -> None:
        self.path = path
        self.rows: dict[int, dict[str, float]] = {}
        head = {"format": FORMAT, "experiment": experiment.name, "digest": _digest(experiment, loop), "metrics": list(metrics)}
        with located(f"--resume: {path}", OSError):
            if path.exists() and not path.is_file():  # a device has no end
                raise HilError(f"--resume: {path} is no file")
            self._file = open(path, "a+b", buffering=0)  # noqa: SIM115 (what does not fit is reported by write)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as e:
            self._file.close()
            raise HilError(f"--resume: {path} is in use by another sweep") from e
        try:
            self._load(head)
        except HilError:
            self._file.close()
            raise

    def _load(self, head: dict[str, Any]) -> None:
        number = size = 0
        torn = b""
        with open(os.dup(self._file.fileno()), "rb") as file:
            file.seek(0)
            while line := file.readline(LONGEST_LINE):
                if not line.endswith(b"\n"):
                    torn = line
                    break
                number += 1
                size += len(line)
                if number == 1:
                    self._check(line, head)
                else:
                    self._row(line, number, head["metrics"])
        if len(torn) >= LONGEST_LINE or (number == 0 and torn and not json.dumps(head).encode().startswith(torn)):
            raise HilError(f"--resume: {self.path} is not the file of a sweep")  # a torn first line of ours is a new file
        if torn:
            self._file.truncate(size)
        if number == 0:
            self._write(self._size(), head)

    def _row(self, line: bytes, number: int, metrics: Sequence[str]) -> None:
        try:
            row = json.loads(line)
            found = {name: math.nan if row[name] is None else float(row[name]) for name in metrics}
            self.rows[int(row["seed"])] = found | {"seed": int(row["seed"])}
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as e:
            raise HilError(f"--resume: {self.path}: line {number} is not a row of this sweep") from e

    def _check(self, line: bytes, head: dict[str, Any]) -> None:
        try:
            found = json.loads(line)
            ours = found["format"] == FORMAT
        except (ValueError, KeyError, TypeError, RecursionError):
            ours = False
        if not ours:
            raise HilError(f"--resume: {self.path} is not the file of a sweep")
        for key in ("experiment", "digest", "metrics"):
            if found.get(key) != head[key]:
                raise HilError(
                    f"--resume: {self.path} holds runs of {found.get('experiment')!r:.60} with another {key}; "
                    f"expected {head['experiment']!r} as it is now"
                )

    def _size(self) -> int:
        return os.fstat(self._file.fileno()).st_size

    def _write(self, start: int, *lines: dict[str, Any]) -> None:
        """Write what is not there yet of lines that begin at a size of the file: it may be called again after an interrupt."""
        data = b"".join(json.dumps(line).encode() + b"\n" for line in lines)
        with located(f"--resume: {self.path}: cannot be written", OSError):
            while (there := self._size() - start) < len(data):  # the last bytes of a disk take a part of it, and no error
                self._file.write(data[there:])

    def add(self, rows: Sequence[dict[str, float]]) -> None:
        """Append finished runs and hand them to the operating system."""
        plain = [{name: None if isinstance(v, float) and math.isnan(v) else v for name, v in row.items()} for row in rows]
        found, start = {int(row["seed"]): row for row in rows}, self._size()
        try:
            self._write(start, *plain)
            self.rows |= found
        except KeyboardInterrupt:  # what was begun is ended first, so that what is reported and the file are the same
            self._write(start, *plain)
            self.rows |= found
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> SweepStore:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _digest(experiment: Experiment, loop: Loop | None) -> str:
    resolved = {k: v for k, v in experiment.resolved().items() if k not in ("seed", "name", "description")}
    resolved |= {} if loop is None else {"loop": digest_of(loop.experiment, loop.controller, loop.model)}
    return hashlib.sha256(json.dumps(resolved, sort_keys=True).encode()).hexdigest()
