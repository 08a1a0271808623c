"""The frames of a log: at the instants that were measured, in the order of time and never all of them in memory; and as messages
of python-can: those of the link, or of the emulated CAN bus where the run had one.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from functools import partial
from itertools import count
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.errors import HilError
from hil.experiment import experiment_from_resolved
from hil.log.append_column import AppendColumn, pieces
from hil.log.read import Run
from hil.log.records import TIME_FIELD
from hil.log.topics import BUS, CONTROL, EXTENDED, FD, FRAME_TOPICS, REMOTE, SENSOR, SWITCH, TIMING
from hil.rig import rig_of
from hil.rig.session_link import no_link

if TYPE_CHECKING:
    from transport.links.can_identifiers import Identifiers

VIRTUAL_BEGIN: Final = "2000-01-01T00:00:00Z"
TOGETHER: Final = 4096
"""Frames that are read at a time."""

MOST_HELD: Final = 200_000
"""Frames that wait in memory for one that stands behind them in the log and before them in time."""

Slots: TypeAlias = npt.NDArray[np.int64]


def measured_frames(run: Run, topic: str) -> Iterator[tuple[int, bytes]]:
    """Give every frame of a topic with its instant in session time, ns: nominal plus what was measured of that slot.

    The order is that of time. The log may have another: an answer that came too late stands behind the next question. How far
    an instant falls behind an earlier one at most is found first; so a frame waits only until none can come before it.

    Args:
        run: the run.
        topic: `/link/sensor` or `/link/control`.

    Raises:
        HilError: the log is so far out of order that more than `MOST_HELD` frames would have to wait.
    """
    measured = _lateness(run, topic)
    behind = _farthest_behind(run, topic, measured)
    held: list[tuple[int, int, bytes]] = []
    newest, order = -(1 << 62), count()  # frames of one instant stay as they stand in the log
    for piece in run.pieces(topic, TOGETHER):
        for t_ns, data in zip((piece[TIME_FIELD] + measured(piece["slot"])).tolist(), piece["data"].tolist()):
            newest = max(newest, t_ns)
            heapq.heappush(held, (t_ns, next(order), bytes(data)))
            while held and held[0][0] <= newest - behind:
                t, _, frame = heapq.heappop(held)
                yield t, frame
            if len(held) > MOST_HELD:
                raise HilError(
                    f"{topic}: the frames are out of order by {behind / 1e9:g} s; more than {MOST_HELD} would have to wait in "
                    "memory, and no session writes such a log"
                )
    while held:
        t, _, frame = heapq.heappop(held)
        yield t, frame


def _farthest_behind(run: Run, topic: str, measured: Callable[[Slots], Slots]) -> int:
    """Return how far an instant lies before the latest of those that stand before it in the log, ns."""
    newest, most = -(1 << 62), 0
    for piece in pieces(run.numbers(topic), TOGETHER):
        at = piece[TIME_FIELD] + measured(piece["slot"])
        latest = np.maximum(np.maximum.accumulate(at), newest)
        most = max(most, int((latest - at).max()))
        newest = int(latest[-1])
    return most


def _lateness(run: Run, topic: str) -> Callable[[Slots], Slots]:
    """Return how much after its nominal instant a frame of a slot came, ns; 0 for a slot that was not timed."""
    numbers, delays, last, ordered = AppendColumn(np.int64), AppendColumn(np.int64), -(1 << 62), True
    for piece in pieces(run.numbers(TIMING.name), TOGETHER):
        late_us: npt.NDArray[np.float64] = piece["lateness_us"]
        if topic == CONTROL.name:
            late_us = late_us + np.nan_to_num(piece["round_trip_us"])
        delays.extend(np.round(late_us * 1e3).astype(np.int64))
        own = piece["slot"].astype(np.int64)
        numbers.extend(own)
        ordered = ordered and own[0] > last and not (own[1:] <= own[:-1]).any()
        last = int(own[-1])
    slots, late_ns = numbers.array(), delays.array()
    if not ordered:
        order = np.argsort(slots, kind="stable")
        late_ns, slots = late_ns[order], slots[order]

    def of(asked: Slots) -> Slots:
        if not len(slots):
            return np.zeros(len(asked), np.int64)
        at = np.maximum(np.searchsorted(slots, asked, side="right") - 1, 0)
        return np.where(slots[at] == asked, late_ns[at], 0)

    return of


def can_topics(run: Run, topics: Sequence[str]) -> list[str]:
    """Return which topics a CAN log is made of: the emulated bus where a run has one, else both directions of the link.

    Args:
        run: the run.
        topics: only these; all where there are none.

    Raises:
        HilError: they hold no frames, or those of two buses.
    """
    there = [topic for topic in (BUS.name, *FRAME_TOPICS) if topic in (topics or run.arrays) and len(run.numbers(topic))]
    if not there:
        raise HilError(f"no frames to write; a CAN log needs the records of {' and '.join(FRAME_TOPICS)}, or of {BUS.name}")
    if topics and BUS.name in there[:-1]:
        raise HilError(f"--topic {BUS.name}: is another bus than the link's; export one file of each")
    return there


def beyond_classic(run: Run, topics: Sequence[str]) -> str:
    """Return what these topics have beside whole frames of classic CAN, in words; nothing where they have no more."""
    if topics[0] != BUS.name:
        return "CAN FD" if _framing(run)[0] else ""
    frames = run.numbers(BUS.name)
    return "CAN FD" if (frames["flags"] & FD).any() else "frames that were destroyed" if frames["operation"].any() else ""


def can_messages(run: Run, topics: Sequence[str]) -> Iterator[Any]:
    """Give the run's frames as they stood on a CAN bus, in the order of time.

    The framing of the link's is that of ``transport.links.can_link``, with the ``fd`` and ``base`` of the session's own link if
    that was CAN. A frame of the emulated bus stands at the end of its EOF, its bytes are 0; one that was destroyed is an error
    frame at the end of its error delimiter.

    Args:
        run: the run.
        topics: of `can_topics`.
    """
    if topics[0] == BUS.name:
        return _of_bus(run)
    return heapq.merge(*(_of_topic(run, topic) for topic in topics), key=attrgetter("timestamp"))


def _begin_s(run: Run) -> float:
    return run.start_ns / 1e9 or datetime.fromisoformat(run.session.get("started", VIRTUAL_BEGIN)).timestamp()


def _of_bus(run: Run) -> Iterator[Any]:
    from transport.links.python_can import can

    begin_s = _begin_s(run)
    for piece in run.pieces(BUS.name, TOGETHER):
        fields = (piece[name].tolist() for name in ("end_ns", "can_id", "operation", "flags", "length"))
        for end_ns, can_id, destroyed, flags, length in zip(*fields):
            at_s = begin_s + end_ns / 1e9
            if destroyed:
                yield can.Message(timestamp=at_s, is_error_frame=True, channel=0, dlc=8, data=bytes(8))
                continue
            remote = bool(flags & REMOTE)
            try:
                yield can.Message(
                    timestamp=at_s, arbitration_id=can_id, is_extended_id=bool(flags & EXTENDED), is_remote_frame=remote,
                    is_fd=bool(flags & FD), bitrate_switch=bool(flags & SWITCH), channel=0, dlc=length,
                    data=None if remote else bytes(length), check=True,
                )  # fmt: skip
            except ValueError as error:
                raise HilError(f"{BUS.name} at {end_ns / 1e9:g} s: {error}; export .csv instead") from error


def _of_topic(run: Run, topic: str) -> Iterator[Any]:
    from transport.links.can_link import CanLink

    uri = run.metadata.get("link", "")
    fd, identifiers = _framing(run)
    bus = _BusOfPaper(fd)
    begin_s = _begin_s(run)
    role: Literal["rig", "controller"] = "rig" if topic == SENSOR.name else "controller"
    link = CanLink(uri, role, lambda: bus, identifiers=identifiers, fd=fd)
    for t_ns, packet in measured_frames(run, topic):
        bus.t_s = begin_s + t_ns / 1e9
        link.send(packet)
        if link.counters.dropped:
            raise HilError(f"{topic} at {t_ns / 1e9:g} s: {len(packet)} bytes do not fit on CAN; export .csv instead")
        yield from bus.messages
        bus.messages.clear()


def _framing(run: Run) -> tuple[bool, Identifiers]:
    """Whether a run's frames are CAN FD, and its identifiers; the default ones of its nodes for what is no CAN link."""
    from transport.links import TransportError
    from transport.links.can_identifiers import derived
    from transport.links.traits import identifiers_on, traits_of

    uri = run.metadata.get("link", "")
    with suppress(TransportError, ValueError):  # no session could have run over it
        framing = traits_of(uri).can
        if framing is not None:
            return framing.fd, identifiers_on(uri)
    if not run.resolved.get("network", {}).get("nodes"):
        return True, derived()
    own = no_link(rig_of(experiment_from_resolved(run.resolved, run.experiment_text, "the log"))).identifiers
    if own is None:
        raise HilError("the log: a CAN link has no identifiers for so many nodes; export .csv instead")
    return True, own


class _BusOfPaper:
    """A bus as a link uses it, that keeps what is said on it as messages of python-can, with the time of the log."""

    lost = turned_away = filtered = 0

    def __init__(self, fd: bool) -> None:
        from transport.links.python_can import can

        self.messages: list[Any] = []
        self.t_s = 0.0
        self._message = partial(can.Message, is_extended_id=False, is_fd=fd, bitrate_switch=fd, channel=0)

    def send_frame(self, identifier: int, data: bytes) -> bool:
        self.messages.append(self._message(arbitration_id=identifier, data=data, timestamp=self.t_s))
        return True

    def recv_frame(self, timeout: float) -> None:
        """No other is on it."""

    def plan(self, faults: object, seed: int, senders: object) -> None:
        """It has no bits."""

    def shutdown(self) -> None:
        """Nothing is open."""
