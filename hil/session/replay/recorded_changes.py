"""What a log says of changes while it ran: slot, path and value of each, as it was made."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from hil.compose.changed import changed
from hil.compose.loop import Loop
from hil.errors import HilError
from hil.log.run import Run
from hil.runtime.changes import CHANGE, END, Change

Asked = tuple[int, str, Any]
"""Slot, path of the field, and value."""


def changes_of(run: Run) -> list[Asked]:
    """Return the changes of a run, in order.

    Raises:
        HilError: an event says otherwise than `hil.runtime.changes.log_change` writes it.
    """
    found = []
    for event in run.events:
        if event["kind"] == CHANGE:
            data = event["data"]
            if not isinstance(data, dict) or not isinstance(data.get("path"), str) or "value" not in data:
                raise HilError(f"event of slot {event['tick']}: a change without path and value")
            found.append((int(event["tick"]), data["path"], data["value"]))
    return found


def composed(loop: Loop, asked: Iterable[Asked], *, certify: bool = True) -> Iterator[tuple[int, Change]]:
    """Give the slot and the loop of each change.

    Args:
        loop: what runs at the beginning.
        asked: in the order of slots.
        certify: whether their certificates are computed.

    Raises:
        ExperimentError: one does not fit.
    """
    for k, path, value in asked:
        if path == END:
            yield k, Change(path=path, value=value, loop=None)
            return
        loop = changed(loop, k, path, value, certify=certify)
        yield k, Change(path=path, value=value, loop=loop)


def refuse_changed(run: Run, source: str, what: str) -> None:
    """Refuse a log of a run that was changed, where its experiment alone is not enough.

    Raises:
        HilError: it was changed.
    """
    if changes_of(run):
        raise HilError(f"{source}: its experiment was changed while it ran; {what} needs one that stayed; --verify does not")
