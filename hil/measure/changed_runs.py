"""What was changed while a run went on: its numbers are then not those of one experiment."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from msgspec import Struct

from hil.log.events import CHANGE
from hil.log.run import Run
from hil.rig.schedules import SCHEDULES


class ChangedField(Struct, frozen=True, kw_only=True):
    """A change of a run.

    Args:
        slot: from which it acts.
        path: of the field.
        certificate: kind, state and reason of what is claimed from then on; empty where nothing is.
    """

    slot: int
    path: str
    certificate: dict[str, Any]


def changed_fields(run: Run) -> tuple[ChangedField, ...]:
    """Return the changes of a run, in order; that it was ended is none."""
    said = [(event.get("slot"), event.get("data")) for event in run.events if event.get("kind") == CHANGE]
    return tuple(
        ChangedField(slot=int(slot or 0), path=str(data.get("path")), certificate=data["certificate"])
        for slot, data in said
        if isinstance(data, dict) and isinstance(data.get("certificate"), dict) and data.get("path") != "end"
    )


def law_was_changed(changes: Iterable[ChangedField], side: str, node: str) -> bool:
    """Return whether the network law of a direction, or of a sensor node, is among the changes of a run."""
    paths = (f"network.{side}.", f"network.nodes.{node}.")
    return any(f"{each.path}.".startswith(paths) for each in changes)


def claimed_to_the_end(run: Run) -> dict[str, Any]:
    """Return the certificate of a run as that of all that ran: with the first change behind which less is claimed.

    Args:
        run: with a certificate.
    """
    found, changes = dict(run.certificate), changed_fields(run)
    if found.get("state") != "certified":
        return found
    lost = next((each for each in changes if each.certificate.get("state") != "certified"), None)
    if lost is None:
        times = sum(each.path not in SCHEDULES for each in changes)
        began = f"when the run began: {found['reason']}; its loop was then changed {times} times, and certified each time"
        return {**found, "reason": began} if times else found
    state, why = (str(lost.certificate.get(name, "undecided")) for name in ("state", "reason"))
    reason = f"certified until slot {lost.slot}, where {lost.path} was changed; then {why}"
    return {**found, "state": state, "stable": False, "stated": found["reason"], "reason": reason}
