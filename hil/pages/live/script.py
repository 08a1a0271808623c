"""What was done on the page, as a file: one change a line, slot, field and value; it runs again without the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec

from hil.compose.changed import refuse_in_real_time
from hil.errors import HilError
from hil.files import read_regular
from hil.log.records import Channel
from hil.log.write import PayloadWriter
from hil.rig.loop import Loop
from hil.runtime.changes import END, Change
from hil.session.replay.recorded import ChangeRequest, changes_of, composed

MOST_BYTES: Final = 20_000_000

MOST: Final = 10_000
"""Changes of a script: every one is composed before the run begins, some milliseconds each, and with a certificate more."""


class Line(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A change, as a line of JSON."""

    slot: int
    field: str
    value: Any = None


def read_script(path: Path) -> list[ChangeRequest]:
    """Return the changes of a script, or of the log of a run that was changed.

    Raises:
        HilError: a line is no change, with its number, the slots are out of order, or there are too many.
    """
    if path.suffix == ".mcap":
        from hil.log.read import read_run

        return changes_of(read_run(path))
    found: list[ChangeRequest] = []
    text = read_regular(path, MOST_BYTES, "a script of changes")
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        try:
            said = msgspec.json.decode(line, type=Line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            form = '{"slot": 40, "field": "reference", "value": [1.0]}'
            raise HilError(f"{path}: line {number}: {error}; expected {form}") from None
        if said.slot < (found[-1][0] if found else 0):
            raise HilError(f"{path}: line {number}: slot {said.slot} comes behind slot {found[-1][0] if found else 0}")
        if len(found) == MOST:
            raise HilError(f"{path}: line {number}: more than {MOST} changes; a run takes no more: divide the script")
        found.append((said.slot, said.field, said.value))
    return found


def script_of(asked: Sequence[ChangeRequest]) -> bytes:
    """Return the text of a script."""
    return b"".join(msgspec.json.encode(Line(slot=k, field=path, value=value)) + b"\n" for k, path, value in asked)


class Counter(Protocol):
    """Shows how many are done."""

    def counted(self, done: int, total: int) -> None: ...


class Scripted:
    """Looks at nothing, and changes a run as a script says; see `hil.session.Onlooker`.

    Args:
        asked: the changes, in the order of slots.
        real: whether the run is in real time.
        working: shows how many changes are composed, of how many.
    """

    clock = None

    def __init__(
        self, asked: Sequence[ChangeRequest], *, real: bool = False, working: AbstractContextManager[Counter | None] | None = None
    ) -> None:
        self._asked, self._real, self._working = asked, real, working or nullcontext()
        self._to_come: list[tuple[int, Change]] = []

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Compose every change: one that does not fit is said before anything runs."""
        for _, path, _ in self._asked if self._real else ():
            if path != END:
                refuse_in_real_time(loop, path)
        found: list[tuple[int, Change]] = []
        with self._working as counter:
            for each in composed(loop, self._asked):
                found.append(each)
                if counter is not None:
                    counter.counted(len(found), len(self._asked))
        self._to_come = found[::-1]
        return {}

    def changes(self, k: int) -> Sequence[Change]:
        """Return the changes of a slot."""
        found = []
        while self._to_come and self._to_come[-1][0] <= k:
            found.append(self._to_come.pop()[1])
        return found

    def end(self) -> None:
        """Nothing waits."""
