"""Changes of a run: which come when, and how a rig, its controller and its log take one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, Literal

from msgspec import Struct

from hil.log.events import CHANGE
from hil.log.write.sinks import Sink
from hil.rig.loop import Loop
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig

LATE: Final = "change late"
"""Kind of the event that logs one that came behind its slot, in real time."""


END: Final = "end"
"""Path of the change that ends a run."""
RUN_ENDED: Final = "the run was ended"


class Change(Struct, frozen=True, kw_only=True):
    """A change, and the loop that runs from it on.

    Args:
        path: of the field, see `hil.compose.changed.changed`.
        value: as the file's parser would give it.
        loop: with its certificate; None: the run ends before the slot.
    """

    path: str
    value: Any
    loop: Loop | None


Changes = Callable[[int], Sequence[Change]]
"""Asked at the beginning of every slot, by its number, for the changes that act from it on."""


def take(change: Change, rig: Rig, node: ControlNode | None) -> None:
    """Let a rig, and its controller where it is in the same process, go on with a change, between two slots."""
    if change.loop is not None:
        direction: Literal["sc", "ca"] | None = None
        if change.path.startswith("network."):
            direction = "ca" if change.path.startswith("network.ca") else "sc"
        rig.change(change.loop, network=direction, plant=change.path.startswith("plant."))
        if node is not None:
            node.change(change.loop, anew=change.path.startswith("controller"))


def log_late(sink: Sink, change: Change, t_ns: int, k: int, slot: int) -> None:
    """Log a change that came behind its slot: it does not act, as its certificate is on a run in which it had."""
    message = f"{change.path}: came in slot {k}, behind its slot {slot}: nothing was changed; change it again"
    sink.event(t_ns, LATE, message, slot=k, severity="warning", path=change.path, due=slot)


def log_change(sink: Sink, change: Change, t_ns: int, k: int) -> None:
    """Log a change, with what is claimed of the loop that it makes."""
    verdict = None if change.loop is None else change.loop.verdict
    claimed = {} if verdict is None else {"kind": verdict.kind, "state": verdict.state, "reason": verdict.reason}
    text = RUN_ENDED if change.loop is None else f"{change.path} changed, certificate: {claimed.get('state', 'none')}"
    sink.event(t_ns, CHANGE, text, slot=k, path=change.path, value=change.value, certificate=claimed)
