"""What is finished of a reproduction that was interrupted: one line per stage, in a file beside the pages.

The file belongs to one process at a time, and to the code that computed it: what other code found is not taken over. A last
line that was torn is cut off. When everything is done the file goes, so that a new call computes anew.

A line is MessagePack in base64, which holds every number as it is. Only what a `Part` has is ever made from it.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from base64 import b64decode, b64encode
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
from msgspec.msgpack import Decoder, encode

import design
import plants
import transport
from hil.errors import HilError, located
from hil.files import refuse_irregular
from hil.thesis import Part

_PART: Final = Decoder(tuple[str, str, Part])
"""Of a line: chapter, stage and what it found."""


def _plain(value: object) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise NotImplementedError(f"{type(value).__name__} cannot be kept")


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
        with located(f"{path}: cannot be used for the state", OSError):
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            self._file = open(os.open(path, flags, 0o666), "r+b", buffering=0)  # noqa: SIM115 (kept open, for the lock)
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
                chapter, stage, part = _PART.decode(b64decode(line, validate=True))
            except (ValueError, RecursionError) as error:
                raise HilError(f"{self.path}: line {number} is no stage of a reproduction; move the file away") from error
            self.stages[chapter, stage] = part
            whole += len(line) + 1
        self._file.truncate(whole)

    def _write(self, line: bytes) -> None:
        with located(f"{self.path}: cannot be written", OSError):
            while line:  # the last bytes of a disk take a part of it, and no error
                line = line[self._file.write(line) :]

    def get(self, chapter: str, stage: str) -> Part | None:
        """What a stage found, if it was done."""
        return self.stages.get((chapter, stage))

    def put(self, chapter: str, stage: str, part: Part) -> None:
        """Keep what a stage found."""
        self._write(b64encode(encode((chapter, stage, part), enc_hook=_plain)) + b"\n")
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
