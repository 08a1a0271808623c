"""What is finished of a reproduction that was interrupted: one line per stage, in a file beside the pages.

The file belongs to one process at a time, and to the code that computed it: what other code found is not taken over. A last
line that was torn is cut off. When everything is done the file goes, so that a new call computes anew.

Only the classes that this file lists are ever made from a checkpoint.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from dataclasses import fields
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

import design
import plants
import transport
from hil.errors import HilError
from hil.files import refuse_irregular
from hil.pages import Band, BarGroup, Bars, Figure, Histogram, Marker, Series
from hil.thesis import Part, Plot
from hil.thesis.judgement import Approximately, Between, Check, Drawn, Equals, NotJudged, Row

CLASSES: dict[str, Any] = {
    kind.__name__: kind
    for kind in (
        Part, Plot, Row, Check, Approximately, Between, Drawn, Equals, NotJudged,
        Figure, Series, Band, Marker, Bars, BarGroup, Histogram,
    )
}
KINDS = {"f": np.float64, "i": np.int64, "b": np.bool_}
TUPLES: dict[Any, Any] = {"tuple[Check, ...]": Check, "tuple[Figure | Bars | Histogram, ...]": (Figure, Bars, Histogram)}
"""What stands in a tuple, by how its field is written."""


def as_plain(value: Any) -> Any:
    """A value of a part as dictionaries, lists, numbers and words.

    Raises:
        TypeError: for a value of a class that is not listed.
    """
    if isinstance(value, np.ndarray) and value.dtype.kind in KINDS:
        return {"array": value.dtype.kind, "values": value.tolist()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple):
        return {"tuple": [as_plain(each) for each in value]}
    if isinstance(value, list):
        return [as_plain(each) for each in value]
    if value is None or isinstance(value, str | int | float):
        return value
    name = type(value).__name__
    if CLASSES.get(name) is not type(value):
        raise TypeError(f"{name} cannot be kept")
    return {"is": name, "has": {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}}


def from_plain(plain: Any) -> Any:
    """What `as_plain` was given.

    Raises:
        ValueError, KeyError, TypeError, AttributeError, OverflowError: if it is nothing that `as_plain` gives.
    """
    if isinstance(plain, list):
        return [from_plain(each) for each in plain]
    if not isinstance(plain, dict):
        return plain
    if "array" in plain:
        return np.array(plain["values"], dtype=KINDS[plain["array"]])
    if "tuple" in plain:
        return tuple(from_plain(each) for each in plain["tuple"])
    made = CLASSES[plain["is"]](**{name: from_plain(each) for name, each in plain["has"].items()})
    for field in fields(made):
        value = getattr(made, field.name)
        if (field.type == "str" and not isinstance(value, str)) or (field.type in TUPLES and not _are(value, TUPLES[field.type])):
            raise TypeError(f"{field.name}: expected {field.type}")
    return made


def _are(values: object, kind: Any) -> bool:
    return isinstance(values, tuple) and all(isinstance(each, kind) for each in values)


FORMAT = "hil-reproduce/1"
_OPENING = f'{{"format": "{FORMAT}"'.encode()
LARGEST = 500_000_000
"""Bytes of a state; whole chapters have some tens of millions."""


class KeptStages:
    """Stages that are done, by chapter and title, in a file that is complete after every one of them.

    Args:
        path: the file; made if it is not there.

    Raises:
        HilError: it is something else, is in use, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stages: dict[tuple[str, str], Part] = {}
        head = json.dumps({"format": FORMAT, "code": digest_of_code()}).encode() + b"\n"
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            self._file = open(os.open(path, flags, 0o666), "r+b", buffering=0)  # noqa: SIM115 (kept open, for the lock)
        except OSError as error:
            raise HilError(f"{path}: cannot be used for the state: {error.strerror or error}") from error
        try:
            refuse_irregular(path, os.fstat(self._file.fileno()).st_mode, "the state of a reproduction")
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._load(head)
        except BlockingIOError:
            self._file.close()
            raise HilError(f"{path} is in use by another reproduction") from None
        except HilError:
            self._file.close()
            raise

    def _load(self, head: bytes) -> None:
        if os.fstat(self._file.fileno()).st_size > LARGEST:
            raise HilError(f"{self.path}: more than {LARGEST} bytes; move it away")
        data = bytearray()
        while block := self._file.read(1 << 20):
            data += block
        first, *lines = bytes(data).split(b"\n")
        if data and first[: len(_OPENING)] != (_OPENING if lines else _OPENING[: len(first)]):  # without lines it is torn
            raise HilError(f"{self.path}: is not the state of a reproduction; move it away")
        if first + b"\n" != head or not lines:  # new, torn in its first line, or of other code
            self._file.truncate(0)
            self._write(head)
            return
        whole = len(first) + 1
        for number, line in enumerate(lines[:-1], start=2):
            try:
                kept = json.loads(line)
                part = from_plain(kept["part"])
                chapter, stage = str(kept["chapter"]), str(kept["stage"])
            except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
                raise HilError(f"{self.path}: line {number} is no stage of a reproduction; move the file away") from error
            if not (isinstance(part, Part) and _are(part.rows, Row) and _are(part.figures, Plot)):
                raise HilError(f"{self.path}: line {number} is no stage of a reproduction; move the file away")
            self.stages[chapter, stage] = part
            whole += len(line) + 1
        self._file.truncate(whole)

    def _write(self, line: bytes) -> None:
        try:
            while line:  # the last bytes of a disk take a part of it, and no error
                line = line[self._file.write(line) :]
        except OSError as error:
            raise HilError(f"{self.path}: cannot be written: {error.strerror or error}") from error

    def get(self, chapter: str, stage: str) -> Part | None:
        """What a stage found, if it was done."""
        return self.stages.get((chapter, stage))

    def put(self, chapter: str, stage: str, part: Part) -> None:
        """Keep what a stage found."""
        self._write(json.dumps({"chapter": chapter, "stage": stage, "part": as_plain(part)}).encode() + b"\n")
        self.stages[chapter, stage] = part

    def done(self) -> None:
        """Take the file away: everything is done."""
        self.path.unlink(missing_ok=True)

    def __enter__(self) -> KeptStages:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self._file.close()


@cache
def digest_of_code() -> str:
    """SHA-256 of every module of the four packages."""
    found = hashlib.sha256()
    for root in (*design.__path__, *plants.__path__, *transport.__path__, str(Path(__file__).parents[1])):
        for path in sorted(Path(root).rglob("*.py")):
            found.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()
