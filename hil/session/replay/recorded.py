"""The recorded frames of a log: the nonces of the sensor frames, the answers that came in time, and the tags of a key."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from hmac import compare_digest
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from hil.compose.changed import changed
from hil.errors import HilError
from hil.log import CHANGE
from hil.log.append_column import AppendColumn, pieces, release
from hil.log.run import Run, StructuredArray
from hil.log.topics import CONTROL, SENSOR, TIMING
from hil.rig.loop import Loop
from hil.runtime.changes import END, Change
from hil.runtime.nodes import Wire, before
from hil.session.replay import BATCH, in_time
from transport.links.authentication import cmac, read_key
from transport.packets import SensorPacket, decode
from transport.wire import tag_of

MOST_SORTED: Final = 200_000
"""Control packets that are sorted where a log has them out of order; hil writes them in order."""


def frames(parts: Iterator[StructuredArray]) -> Iterator[tuple[int, bytes]]:
    """Yield slot and bytes of every frame."""
    for piece in parts:
        yield from zip(piece["slot"].tolist(), map(bytes, piece["data"]))


class RecordedAnswers:
    """The control packets that arrived in time, asked for slot by slot.

    Args:
        run: the log.

    Raises:
        HilError: they are out of order, and too many to be sorted in memory.
    """

    def __init__(self, run: Run) -> None:
        self._numbers = run.numbers(CONTROL.name)
        self._frames = frames(map(in_time, run.pieces(CONTROL.name, BATCH)))
        count, last, ordered = 0, -(1 << 62), True
        for slots in self._slots():
            ordered = ordered and int(slots[0]) >= last and not (slots[1:] < slots[:-1]).any()
            count, last = count + len(slots), int(slots[-1])
        if not ordered and count > MOST_SORTED:
            raise HilError(f"/link/control: {count} packets that are out of order; hil sorts {MOST_SORTED} at most")
        # A dict keeps the last of one slot; in a log that is in order it need hold no more than the slot at hand.
        self._held: dict[int, bytes] = {} if ordered else dict(self._frames)
        self._all = None if ordered else frozenset(self._held)
        self._next = next(self._frames, None)

    def _slots(self) -> Iterator[NDArray[np.integer[Any]]]:
        return (slots for piece in pieces(self._numbers, BATCH) if len(slots := in_time(piece)["slot"]))

    def answered(self, end: int) -> int:
        """Return in how many slots below a number a packet arrived in time."""
        if self._all is not None:
            return sum(k < end for k in self._all)
        count, last = 0, -(1 << 62)
        for slots in self._slots():
            count += int(slots[0] != last and slots[0] < end) + int(np.count_nonzero((np.diff(slots) != 0) & (slots[1:] < end)))
            last = int(slots[-1])
        return count

    def get(self, k: int) -> bytes | None:
        """Return the packet of a slot; slots are asked for in order."""
        while self._next is not None and self._next[0] <= k:
            self._held = {self._next[0]: self._next[1]}
            self._next = next(self._frames, None)
        return self._held.get(k)


def recorded_wire(run: Run) -> Wire:
    """Return the nonces of the recorded questions."""
    slots, nonces = AppendColumn(np.int64), AppendColumn(np.uint64)
    for piece in run.pieces(SENSOR.name, BATCH):
        asked = {slot: decode(bytes(data)) for slot, data in zip(piece["slot"].tolist(), piece["data"])}
        questions = {slot: packet for slot, packet in asked.items() if isinstance(packet, SensorPacket)}
        slots.extend(np.fromiter(questions, np.int64, len(questions)))
        nonces.extend(np.fromiter((packet.nonce for packet in questions.values()), np.uint64, len(questions)))
    return Wire(nonce=_Nonces(slots.array(), nonces.array()).of)


class _Nonces:
    """The nonces of the questions, a stretch of slots at a time."""

    def __init__(self, slots: NDArray[Any], nonces: NDArray[Any]) -> None:
        if any((piece[1:] < piece[:-1]).any() for piece in pieces(slots)):
            order = np.argsort(slots, kind="stable")
            slots, nonces = slots[order], nonces[order]
        self._slots, self._nonces = slots, nonces
        self._begin = self._end = 0
        self._known: dict[int, int] = {}

    def of(self, k: int) -> int:
        """Return the nonce of a slot's question, 0 if none was asked; of several the last."""
        if not self._begin <= k < self._end:
            self._begin, self._end = k, k + BATCH
            first, last = np.searchsorted(self._slots, (self._begin, self._end))
            self._known = dict(zip(self._slots[first:last].tolist(), self._nonces[first:last].tolist()))
            release(self._slots)
            release(self._nonces)
        return self._known.get(k, 0)


class Woken:
    """When each slot began: a watchdog that looks at the clock trips again where it did. Slots are asked for in order.

    Args:
        run: the log.
        period_ns: sample period, ns.
    """

    def __init__(self, run: Run, period_ns: int) -> None:
        timed = run.pieces(TIMING.name, BATCH) if TIMING.name in run.arrays else iter(())
        self._late = (late for piece in timed for late in zip(piece["slot"].tolist(), piece["lateness_us"].tolist()))
        self._period_ns, self._next = period_ns, next(self._late, None)

    def at(self, t_ns: int) -> int:
        """Return when the slot of a nominal time began, ns; at that time where the log does not say."""
        k = t_ns // self._period_ns
        while self._next is not None and self._next[0] < k:
            self._next = next(self._late, None)
        return t_ns if self._next is None or self._next[0] != k else t_ns + round(self._next[1] * 1e3)


class Tags(Struct, frozen=True, kw_only=True):
    """Result of verifying the tags of a log.

    Args:
        verified: answers, late ones too, whose tag is that of the key.
        wrong: answers without a tag, or with another one.
        first: slot of the first of those, None if there is none.
    """

    verified: int
    wrong: int
    first: int | None


def verify_tags(run: Run, key: Path, source: str = "log") -> Tags:
    """Compute the tag of every recorded answer again.

    The nonce of the session, which every code covers, is that from which the nonce of slot 0 follows.

    Args:
        run: the log.
        key: the key of the frames, as `hil keys new` makes it.
        source: the log's name, for messages.

    Raises:
        HilError: the log has no nonce of slot 0: no real link was there.
        TransportError: the file is no key, or others can read it.
    """
    code, first_nonce = cmac(read_key(str(key))), recorded_wire(run).nonce(0)
    if not first_nonce:
        raise HilError(f"{source}: has no nonce of slot 0, so no session over a link; --auth needs one with auth=")
    session = before(first_nonce).to_bytes(8, "little")
    verified, wrong = 0, 0
    first: int | None = None
    for slot, data in frames(run.pieces(CONTROL.name, BATCH)):
        said = tag_of(data)
        if said is not None and compare_digest(code(session + said.signed), said.tag):
            verified += 1
        else:
            wrong += 1
            first = slot if first is None else first
    return Tags(verified=verified, wrong=wrong, first=first)


ChangeRequest = tuple[int, str, Any]
"""A change of an experiment in its run: slot, path of the field, and value."""


def changes_of(run: Run) -> list[ChangeRequest]:
    """Return the changes of a run, in order.

    Raises:
        HilError: an event is not as `hil.runtime.changes.log_change` writes it.
    """
    found = []
    for event in run.events:
        if event["kind"] == CHANGE:
            data = event["data"]
            if not isinstance(data, dict) or not isinstance(data.get("path"), str) or "value" not in data:
                raise HilError(f"event of slot {event['slot']}: a change without path and value")
            found.append((int(event["slot"]), data["path"], data["value"]))
    return found


def composed(loop: Loop, changes: Iterable[ChangeRequest], *, certify: bool = True) -> Iterator[tuple[int, Change]]:
    """Yield the slot and the loop of each change.

    Args:
        loop: what runs at the beginning.
        changes: in the order of slots.
        certify: whether their certificates are computed.

    Raises:
        ExperimentError: one does not fit.
    """
    for k, path, value in changes:
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
