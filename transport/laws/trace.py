"""Recorded ages: a list in the experiment, or a CSV file with one age per line."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from os import PathLike
from pathlib import Path
from stat import S_ISREG
from typing import ClassVar, Literal, TextIO

import numpy as np
from numpy.typing import NDArray

from transport.errors import FieldError
from transport.laws.age import AgePath, checked_age

MAX_BYTES = 20_000_000
MAX_ENTRIES = 2_000_000
"""The most entries that a trace may have: more than half an hour at 1 kHz."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceAge:
    """Ages from a recorded trace, one per slot; the mode is the age.

    Args:
        ages: ages in slots; empty when a file is given.
        file: CSV file with the ages in the column `age`, or in its first column when it has no heading. Lines that
            start with "#" are skipped. A relative name counts from the experiment's folder.
        past_end: after the last entry begin again ("repeat"), or have no more to give ("refuse"; then a run must not be
            longer).
        allow_gaps: accept an age that grows by more than one per slot.

    Raises:
        ValueError: names the entry, or the line of the file.
    """

    kind: ClassVar[str] = "trace"
    family: ClassVar[Literal["age"]] = "age"

    ages: tuple[int, ...] = ()
    file: str = ""
    past_end: Literal["repeat", "refuse"] = "repeat"
    allow_gaps: bool = False

    def __post_init__(self) -> None:
        if bool(self.ages) == bool(self.file):
            raise FieldError("ages", "expected either a list of ages or a file, and not both")
        if self.past_end not in ("repeat", "refuse"):
            raise FieldError("past_end", f'got {self.past_end!r}, expected "repeat" or "refuse"')
        ages = tuple(checked_age(f"ages[{k}]", age) for k, age in enumerate(self.ages))
        object.__setattr__(self, "ages", ages)
        self._check("ages", ages)

    def _check(self, path: str, ages: tuple[int, ...]) -> None:
        if self.allow_gaps:
            return
        for k, age in enumerate(ages):
            if k and age > ages[k - 1] + 1:
                raise FieldError(
                    f"{path}[{k}]",
                    f"the age grows from {ages[k - 1]} to {age}, at most 1 per slot is possible (allow_gaps permits it)",
                )
        if ages and self.past_end == "repeat" and ages[0] > ages[-1] + 1:
            raise FieldError(
                f"{path}[0]",
                f"the age grows from {ages[-1]} (the last) to {ages[0]} on repeating, "
                "at most 1 per slot is possible (allow_gaps permits it)",
            )

    def loaded(self, directory: str | PathLike[str] | None = None) -> TraceAge:
        """Return the law with its file read.

        Raises:
            ValueError: the file is missing or faulty; the message starts with "file".
        """
        if not self.file:
            return self
        ages = read_ages(Path(directory or ".") / self.file)
        self._check("file: entry ", ages)
        return replace(self, ages=ages, file="")

    @property
    def max_age(self) -> int:
        """Largest age in the trace, in slots."""
        return max(self.loaded().ages)

    @property
    def length(self) -> int | None:
        """Number of slots that the trace serves, None for without end."""
        return None if self.past_end == "repeat" else len(self.loaded().ages)

    def recorded(self) -> NDArray[np.int64]:
        """Return the ages of slots 0, 1, ... (ages,)."""
        return np.array(self.loaded().ages, dtype=np.int64)

    @property
    def mode_ages(self) -> tuple[int, ...]:
        """Age of every mode, in slots: the mode itself."""
        return tuple(range(self.max_age + 1))

    def start(self, rng: np.random.Generator) -> AgePath:
        """Return the process; it draws nothing from `rng`."""
        return AgePath.of(self._path())

    def _path(self) -> Iterator[tuple[int, int]]:
        pairs = [(age, age) for age in self.mode_ages]
        states = [pairs[age] for age in self.loaded().ages]
        yield from states
        while self.past_end == "repeat":
            yield from states
        raise FieldError("ages", f"the trace has {len(states)} entries, the run needs more (past_end = 'refuse')")

    def ages_of_batch(self, rngs: Iterable[np.random.Generator], runs: int, slots: int) -> NDArray[np.int32]:
        """Return the ages that many processes draw, (slots, runs): the trace, in every run."""
        ages = np.array(self.loaded().ages, dtype=np.int32)
        if slots > len(ages) and self.past_end == "refuse":
            raise FieldError("ages", f"the trace has {len(ages)} entries, and the run asks for {slots} (past_end = 'refuse')")
        return np.tile(np.resize(ages, slots)[:, None], (1, runs))

    def stationary(self) -> NDArray[np.float64]:
        """Return the share of slots of every mode in the trace, (max_age + 1,)."""
        ages = self.loaded().ages
        return np.bincount(ages) / len(ages)

    def mean_bursts(self) -> NDArray[np.float64]:
        """Return the mean number of slots that a mode lasts in the trace, (max_age + 1,); NaN for absent modes."""
        ages = np.array(self.loaded().ages)
        starts = np.concatenate([[True], ages[1:] != ages[:-1]])
        slots = np.bincount(ages).astype(np.float64)
        bursts = np.bincount(ages[starts], minlength=len(slots))
        means: NDArray[np.float64] = np.divide(slots, bursts, out=np.full(len(slots), np.nan), where=bursts > 0)
        return means


def read_column(path: Path, column: str) -> Iterator[str]:
    """Yield one column of a CSV file as text: the named one if there is a heading, else the first.

    Args:
        path: a regular file of at most `MAX_BYTES` and `MAX_ENTRIES`; it is read as it is asked for.
        column: heading.

    Raises:
        ValueError: the file is missing, no regular one, no text, too large or empty; the message starts with "file".
    """
    entries = 0
    try:
        with _regular(path) as stream:
            rows = (row for row in csv.reader(stream) if row and not row[0].lstrip().startswith("#"))
            first = next(rows, [])
            heading = [name.strip() for name in first]
            index = heading.index(column) if column in heading else 0
            for row in rows if column in heading or not first else chain([first], rows):
                entries += 1
                if entries > MAX_ENTRIES:
                    raise FieldError("file", f"{path} has more than {MAX_ENTRIES} entries")
                yield row[index].strip() if index < len(row) else ""
    except OSError as fault:
        raise FieldError("file", f"{path}: {fault.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as fault:
        raise FieldError("file", f"{path} is no CSV text: {fault}") from None
    if not entries:
        raise FieldError("file", f"{path} has no entries")


def _regular(path: Path) -> TextIO:
    """Open a regular file of bounded size as text; a pipe is not waited for."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        status = os.fstat(descriptor)
        if not S_ISREG(status.st_mode):
            raise FieldError("file", f"{path} is no regular file")
        if status.st_size > MAX_BYTES:
            raise FieldError("file", f"{path} has more than {MAX_BYTES} bytes")
        return open(descriptor, newline="", encoding="utf-8-sig")
    except BaseException:
        os.close(descriptor)
        raise


def read_ages(path: Path) -> tuple[int, ...]:
    """Return the ages in a CSV file; faults are named by entry, counted from 0."""
    ages = []
    for k, text in enumerate(read_column(path, "age")):
        if not (text.isdecimal() and len(text) < 10):
            raise FieldError("file", f"{path}: entry {k} is {text!r:.60}, expected a whole number of slots")
        ages.append(checked_age(f"file: {path}: entry {k}", int(text)))
    return tuple(ages)
