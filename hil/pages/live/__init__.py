"""The live page: a run that is watched in a browser, and in virtual time changed from there.

Here is the run: its newest records, its events, and the changes that wait for their slot.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.controllers.rendered_wall import WallController
from hil.log import CHANGE, decode_event
from hil.log.records import CDR_HEADER, EVENTS_TOPIC, Channel, Schema
from hil.log.run import Run
from hil.log.topics import CA, MEASUREMENT, REFERENCE, SC, STATE, TIMING, panels
from hil.log.write import PayloadWriter
from hil.rig.loop import Loop
from hil.runtime.changes import END, LATE, Change, Changes
from hil.runtime.clock import PacedClock
from hil.session.replay.recorded import ChangeRequest, changes_of
from transport.draws import REASONS

EVENTS: Final = 300
"""Events that the page shows at most."""
LATENESS: Final = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 1e9)
"""Edges of the histogram of lateness, us."""
GIVEN: Final = "given"
"""State that is the passivity observer, see `plants.omni.Omni`."""
QUIET: Final = ("repeated", "sent", "delivered", "none-yet")
"""Fates of packets that are no news."""
KEPT: Final = 16_000_000
"""Bytes that are kept of a topic, at least; twice as many at most."""

_SKIP: Final = len(CDR_HEADER)
Records = NDArray[np.void]


class Tail:
    """Records of a topic of numbers, as they come; the oldest are forgotten.

    A reader keeps the buffer with which it began: the writer never changes a byte that it has handed out.

    Args:
        schema: of the topic; it has no raw frames.
        most: bytes that are kept, at least.
    """

    def __init__(self, schema: Schema, most: int = KEPT) -> None:
        self._dtype, self._size = schema.dtype, schema.dtype.itemsize
        self._room = max(most // self._size, 2) * self._size
        self._state = bytearray(2 * self._room), 0

    def put(self, t_ns: int, payload: bytes) -> None:
        """Take a record."""
        buffer, end = self._state
        if end == len(buffer):
            fresh = bytearray(len(buffer))
            fresh[: self._room] = buffer[end - self._room :]
            buffer, end = fresh, self._room
        after = end + self._size
        buffer[end:after] = payload[_SKIP : _SKIP + self._size]
        self._state = buffer, after

    def records(self) -> Records:
        """Return the newest records, a structured array; it costs no copy."""
        buffer, end = self._state
        found: Any = np.frombuffer(buffer, self._dtype, end // self._size)
        return found  # type: ignore[no-any-return]


class Trace(Struct, frozen=True, kw_only=True):
    """One curve of a scope.

    Args:
        panel: title of the scope.
        topic, field: where its values stand.
        unit: of its values.
    """

    panel: str
    topic: str
    field: str
    unit: str


def traces_of(schemas: Mapping[str, Schema]) -> tuple[Trace, ...]:
    """Return the curves of a session's scopes, from its registry of topics, scope by scope."""
    units = {(topic, f.name): f.unit for topic, schema in schemas.items() for f in schema.fields}
    return tuple(
        Trace(panel=panel, topic=topic, field=curve.field, unit=units[topic, curve.field])
        for panel, curves in panels(schemas).items()
        for topic, curve in curves
    )


class Side:
    """Watches one run; see `hil.session.Onlooker`.

    Args:
        clock: paces the run in virtual time; None in real time.
        acts: whether its experiment may be changed while it runs.
    """

    def __init__(self, clock: PacedClock | None = None, acts: bool = False) -> None:
        self.clock, self.acts = clock, acts
        self._turn = threading.Lock()
        self._runs = 0
        self.forget()

    def forget(self, clock: PacedClock | None = None) -> None:
        """Be ready for another run.

        Args:
            clock: of that run.
        """
        self.clock = clock or self.clock
        self._runs += 1
        self.first: Loop | None = None
        self.loop: Loop | None = None  # with every change that is armed
        self.status = "waiting"
        self.waits = ""  # for what, until the run begins
        self.name = ""
        self.period_s = 1.0
        self.traces: tuple[Trace, ...] = ()
        self.done: list[ChangeRequest] = []
        self._certificate: dict[str, Any] | None = None  # of a log
        self._records: Callable[[], Mapping[str, Records]] = dict
        self._events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=EVENTS)
        self._numbers = count()
        self._armed: deque[tuple[int, Change]] = deque()
        self._before: deque[Loop] = deque()  # in real time: what ran before each change that may yet come late
        self.era = 0  # see `Change`
        self._asked = -1  # the newest slot whose changes were asked for

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Watch a run from its beginning."""
        timed = self.clock is None  # in virtual time nothing is late
        schemas = {t: channel.schema for t, channel in channels.items() if not channel.schema.raw and (timed or t != TIMING.name)}
        tails = {topic: Tail(schema) for topic, schema in schemas.items()}
        self._records = lambda: {topic: tail.records() for topic, tail in tails.items()}
        self._take(loop, schemas)
        self.status = "running"
        return {**{topic: tail.put for topic, tail in tails.items()}, EVENTS_TOPIC: self._event}

    def show(self, run: Run, loop: Loop) -> None:
        """Watch the run of a log: it is there from its beginning to its end.

        Raises:
            HilError: a change in it is none.
        """
        arrays = {topic: run.numbers(topic) for topic, schema in run.schemas.items() if not schema.raw and topic in run.arrays}
        schemas = {topic: run.schemas[topic] for topic, records in arrays.items() if len(records)}
        self._records = lambda: arrays
        self._take(loop, schemas)
        self._certificate = run.certificate or None
        self.done.extend(changes_of(run))
        self._events.extend(zip(self._numbers, run.events))
        self.status = "log"

    def _take(self, loop: Loop, schemas: Mapping[str, Schema]) -> None:
        e = loop.experiment
        self.first = self.loop = loop
        self.name, self.period_s = e.name, float(e.period)
        follows = not isinstance(loop.controller, WallController)  # who renders a wall follows no reference
        self.traces = tuple(each for each in traces_of(schemas) if follows or each.topic != REFERENCE.name)

    def _event(self, t_ns: int, payload: bytes) -> None:
        self._note(decode_event(payload))

    def _note(self, event: dict[str, Any]) -> None:
        if event["kind"] == CHANGE:
            self.done.append((event["slot"], event["data"]["path"], event["data"]["value"]))
        if event["kind"] in (CHANGE, LATE) and event["data"]["path"] != END and self._before:
            before = self._before.popleft()
            with self._turn:
                if event["kind"] == LATE and event["data"]["era"] == self.era:  # what comes next is composed upon what runs
                    self.loop, self.era = before, self.era + 1
        self._events.append((next(self._numbers), event))

    def arm(self, k: int, change: Change) -> bool:
        """Let a change act from slot k on; return False where that slot has begun, or what it was composed upon does not run."""
        with self._turn:
            if k <= self._asked or (change.loop is not None and change.era != self.era):
                return False
            self._armed.append((k, change))
            if change.loop is not None:
                if self.clock is None and self.loop is not None:
                    self._before.append(self.loop)
                self.loop = change.loop
            return True

    @property
    def changes(self) -> Changes | None:
        """What is asked for the changes of a slot; None where the run takes none."""
        return self._due if self.acts else None

    def _due(self, k: int) -> Sequence[Change]:
        """Return the changes that act from slot k on."""
        with self._turn:
            self._asked = k
            found = []
            while self._armed and self._armed[0][0] <= k:
                found.append(self._armed.popleft()[1])
            return found

    def next_slot(self) -> int:
        """Return the first slot for which a change can be armed: behind those that are armed already."""
        with self._turn:
            return max(self._asked + 1, self._armed[-1][0] if self._armed else 0)

    def end(self) -> None:
        """Wait for nothing more."""
        if self.clock is not None:
            self.clock.end()

    def stop(self) -> None:
        """End the run before its next slot, its first where it is still composed; a signal handler may call it."""
        self.end()
        while not self.arm(self.next_slot(), Change(path=END, value=None, loop=None)):
            pass

    def records(self) -> Mapping[str, Records]:
        """Return the newest records by topic."""
        return self._records()

    def span(self) -> tuple[int, int]:
        """Return the first slot that is kept, and the number of slots so far."""
        measured = self.records().get(MEASUREMENT.name)
        if measured is None or not len(measured):
            return 0, 0
        return int(measured["slot"][0]), int(measured["slot"][-1]) + 1

    def now(self, since: int, words: bool) -> dict[str, Any]:
        """Return what the page shows beside the scopes.

        Args:
            since: number of the first event that the page has not.
            words: with what changes slowly: certificate, counters, histogram.
        """
        first, end = self.span()
        clock = self.clock
        paused = clock is not None and clock.paused and self.status == "running"
        found: dict[str, Any] = {
            "run": self._runs, "status": "paused" if paused else self.status,
            "first": first, "slots": end, "period": self.period_s,
            "events": [{"number": number, **event} for number, event in list(self._events) if number >= since],
            "device": self._device(end),
        }  # fmt: skip
        if words:
            found |= {"speed": None if clock is None else clock.speed, "certificate": self.claim(), "changes": len(self.done)}
            found |= self._counted() | {"given": self._given()}
        return found

    def claim(self, loop: Loop | None = None) -> dict[str, Any]:
        """Return the certificate of a loop, by default of the one that runs, as JSON."""
        if self._certificate is not None:
            return {"run": self.name, **self._certificate}
        loop = loop or self.loop
        verdict = None if loop is None else loop.verdict
        if verdict is None:
            return {"run": self.name, "state": "none", "kind": "", "reason": "no certificate"}
        return {"run": self.name, **verdict.to_json()}

    def _device(self, end: int) -> dict[str, float]:
        """Return the newest states, for the picture of the device."""
        states = self.records().get(STATE.name)
        if states is None or not len(states):
            return {}
        return {name: float(states[name][-1]) for name in states.dtype.names or () if name != "slot"}

    def _given(self) -> float | None:
        """Return the most energy in J that the passivity observer of a held device has seen given; None without one."""
        states = self.records().get(STATE.name)
        if states is None or GIVEN not in (states.dtype.names or ()) or not len(states):
            return None
        return float(states[GIVEN].max())

    def _counted(self) -> dict[str, Any]:
        records = self.records()
        fates: dict[str, dict[str, int]] = {}
        for topic in (SC.name, CA.name):
            if topic in records and len(records[topic]):
                counts = np.bincount(records[topic]["reason"], minlength=len(REASONS))
                fates[topic] = {name: int(n) for name, n in zip(REASONS, counts) if n and name not in QUIET}
        timing = records.get(TIMING.name)
        if timing is None or not len(timing) or self.loop is None:
            return {"fates": fates, "timing": None}
        lateness = timing["lateness_us"]
        e = self.loop.experiment
        return {"fates": fates, "timing": {
            "counts": np.histogram(lateness, LATENESS)[0].tolist(), "edges": LATENESS[:-1],
            "deadline": e.timing.deadline * self.period_s * 1e6, "worst": float(lateness.max()),
            "work": float(np.median(timing["work_us"])), "late": int(timing["late"].sum()),
            "overrun": int(timing["overrun"].sum()),
        }}  # fmt: skip
