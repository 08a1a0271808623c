"""Changes of an experiment while it runs: how rig, controller and log take one, and how it reaches their processes in real time.

In real time the supervisor sends changes to the rig and controller processes, `LEAD_S` before their slot, so that each has come
when its slot begins; no process waits for one.
"""

from __future__ import annotations

import os
import pickle
import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any, Final, Literal

from msgspec import Struct

from hil.log import CHANGE, decode_event
from hil.log.records import EVENTS_TOPIC
from hil.log.write import PayloadWriter, Sink
from hil.rig.loop import Loop
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig

if TYPE_CHECKING:
    import socket

LATE: Final = "change late"
"""Kind of the event that logs a change that does not act: it, or one before it, came after its slot had begun, in real time."""
END: Final = "end"
"""Path of the change that ends a run."""
RUN_ENDED: Final = "the run was ended"


class Change(Struct, frozen=True, kw_only=True):
    """A change, and the loop that runs from it on.

    Args:
        path: of the field, see `hil.compose.changed.changed`.
        value: as the file's parser would give it.
        loop: with its certificate; None: the run ends before the slot.
        era: how many changes had come late as far as who composed the loop knew; what was composed upon one acts no more than it.
    """

    path: str
    value: Any
    loop: Loop | None
    era: int = 0


Changes = Callable[[int], Sequence[Change]]
"""Called at the beginning of every slot, with its number; returns the changes that act from this slot on."""


def take(change: Change, rig: Rig, node: ControlNode | None) -> None:
    """Apply a change, between two slots, to a rig, and to its controller where it is in the same process."""
    if change.loop is not None:
        direction: Literal["sc", "ca"] | None = None
        if change.path.startswith("network."):
            direction = "ca" if change.path.startswith("network.ca") else "sc"
        rig.change(change.loop, network=direction, plant=change.path.startswith("plant."))
        if node is not None:
            node.change(change.loop, new_controller=change.path.startswith("controller"))


def log_late(sink: Sink, change: Change, t_ns: int, k: int, slot: int) -> None:
    """Log a change that does not act: it came behind its slot, or its certificate is of a loop with one that did."""
    why = f"came in slot {k}, behind its slot {slot}" if slot < k else "was composed upon a change that came late"
    message = f"{change.path}: {why}: nothing was changed; change it again"
    sink.event(t_ns, LATE, message, slot=k, severity="warning", path=change.path, due=slot, era=change.era)


def log_change(sink: Sink, change: Change, t_ns: int, k: int) -> None:
    """Log a change, with the verdict on the changed loop."""
    verdict = None if change.loop is None else change.loop.verdict
    claimed = {} if verdict is None else {"kind": verdict.kind, "state": verdict.state, "reason": verdict.reason}
    text = RUN_ENDED if change.loop is None else f"{change.path} changed, certificate: {claimed.get('state', 'none')}"
    sink.event(t_ns, CHANGE, text, slot=k, path=change.path, value=change.value, certificate=claimed)


LEAD_S: Final = 0.15
_HEAD: Final = struct.Struct("<I")
_READ_BYTES: Final = 1 << 16

Dump = Callable[[object, IO[bytes]], None]
"""Pickles an object into a file."""


class ChangeSenders:
    """The sending ends of the changes, a socket pair for each process by its name; no method waits.

    Args:
        enabled: False for a run that takes no changes: no socket is opened, and nothing is sent.
    """

    def __init__(self, enabled: bool) -> None:
        self._enabled = enabled
        self._senders: dict[str, tuple[socket.socket, socket.socket, bytearray]] = {}  # our end, theirs, unsent bytes

    def open(self, name: str) -> int:
        """Return the file descriptor that a process inherits; one of the same name before is closed. -1 where not enabled."""
        if not self._enabled:
            return -1
        self._close(name)
        from socket import socketpair  # of real time

        ours, theirs = socketpair()
        ours.setblocking(False)
        self._senders[name] = ours, theirs, bytearray()
        return theirs.fileno()

    def passed(self, name: str, *more: int) -> tuple[int, ...]:
        """Return all descriptors that a process inherits: that of its changes, and `more`."""
        return (*more, self._senders[name][1].fileno()) if self._enabled else more

    def put(self, name: str, slot: int, change: Change, dump: Dump = pickle.dump) -> None:
        """Queue a change for a process, where there is one of that name."""
        if name in self._senders:
            text = BytesIO()
            dump((slot, change), text)
            self._senders[name][2].extend(_HEAD.pack(len(text.getvalue())) + text.getvalue())

    def flush(self) -> None:
        """Send as much of the queues as the sockets take; what goes to a process that has ended is lost."""
        for ours, _, waiting in self._senders.values():
            if waiting:
                with suppress(OSError):
                    del waiting[: ours.send(waiting)]

    def close(self) -> None:
        """Send nothing more."""
        for name in list(self._senders):
            self._close(name)

    def _close(self, name: str) -> None:
        if name in self._senders:
            ours, theirs, _ = self._senders.pop(name)
            ours.close()
            theirs.close()


class ChangeReceiver:
    """The receiving end of the changes; it never waits.

    Args:
        fd: file descriptor of the socket; -1 for none.
    """

    def __init__(self, fd: int) -> None:
        self._fd, self._bytes = fd, bytearray()
        self._arrived: deque[tuple[int, Change]] = deque()
        self._era = 0
        if fd >= 0:
            os.set_blocking(fd, False)

    def due(self, k: int, *, ahead: bool = False) -> Iterator[tuple[int, Change, bool]]:
        """Yield the changes that have come, with their slots, and whether each acts; one system call where none has come.

        One that came behind its slot does not, nor does one that was composed upon it; the end of a run always does.

        Args:
            k: the next slot; changes of later ones wait.
            ahead: whether they do not.
        """
        if self._fd >= 0:
            self._read()
        while self._arrived and (ahead or self._arrived[0][0] <= k):
            slot, change = self._arrived.popleft()
            late = change.path != END and (slot < k or change.era < self._era)
            self._era = max(self._era, change.era + late)
            yield slot, change, not late

    def _read(self) -> None:
        try:
            self._bytes += os.read(self._fd, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError:  # the other end has gone: so will this process
            self._fd = -1
            return
        while len(self._bytes) >= _HEAD.size:
            end = _HEAD.size + _HEAD.unpack_from(self._bytes)[0]
            if len(self._bytes) < end:
                return
            self._arrived.append(pickle.loads(bytes(self._bytes[_HEAD.size : end])))
            del self._bytes[:end]


class ChangeSchedule:
    """Calls for the changes of every slot once, `LEAD_S` ahead of the run, and learns from the rig's events which of them act.

    Args:
        changes: called with each slot; None for a run that takes no changes.
        period_ns: length of a slot, ns.

    Attributes:
        undecided: changes that were sent, with their slots, of which the rig has said nothing yet.
    """

    def __init__(self, changes: Changes | None, period_ns: int) -> None:
        self._changes, self._period_ns = changes, period_ns
        self._lead, self._next = 1 + round(LEAD_S * 1e9 / period_ns), 0
        self.undecided: deque[tuple[int, Change]] = deque()
        self._acts: deque[bool] = deque()  # of the first of them, as the log's thread learns it

    def listeners(self) -> dict[str, PayloadWriter]:
        """Return what takes the rig's events, by their topic; nothing for a run without changes."""
        return {} if self._changes is None else {EVENTS_TOPIC: self._learn}

    def _learn(self, t_ns: int, payload: bytes) -> None:
        kind = decode_event(payload)["kind"]
        if kind in (CHANGE, LATE):
            self._acts.append(kind == CHANGE)

    def taken(self) -> Iterator[tuple[int, Change]]:
        """Yield the changes, with their slots, that the rig has taken since the last call."""
        while self._acts:
            sent = self.undecided.popleft()
            if self._acts.popleft():
                yield sent

    def at(self, now_ns: int) -> Iterator[tuple[int, Change]]:
        """Yield the changes that are due to be sent, with their slots.

        Args:
            now_ns: session time, ns; below 0 before slot 0.
        """
        if self._changes is None:
            return
        end = now_ns // self._period_ns + self._lead
        for k in range(self._next, end + 1):
            self._next = k + 1
            for change in self._changes(k):
                self.undecided.append((k, change))
                yield k, change
