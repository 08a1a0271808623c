"""Replays a log over a real link: sends the recorded sensor frames to a controller process, or all recorded frames to a bus.

The answers of the process are compared with the recorded ones, as in openpilot's process replay: a change of the process shows as
a difference of its data. The sensor frames are those of the log, bit for bit; `MAY_DIFFER` lists the fields in which answers may
differ. A slot waits for its answer, so the result does not depend on the speed of the process or the machine; one whose answer
was not recorded waits `UNRECORDED_S`, so that a row of them floods no queue.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from itertools import chain, groupby
from operator import itemgetter
from typing import Final

import numpy as np
from msgspec import Struct

from hil.errors import HilError
from hil.log.read.can_log import measured_frames
from hil.log.run import Run
from hil.log.topics import CONTROL, FRAME_TOPICS, SENSOR
from hil.measure.summary import percentiles
from hil.rig import rig_of
from hil.rig.session_link import link_of, opened
from hil.runtime.clock import RealClock, monotonic_ns
from hil.runtime.nodes import Wire, before
from hil.runtime.real.ending import useless_frames
from hil.runtime.real.exchange import Handshake
from hil.session.replay import BATCH, near_values
from hil.session.replay.recorded import frames, recorded_wire, refuse_changed
from hil.session.replay.replay import experiment_of
from transport.links import Link
from transport.packets import ControlPacket, decode

MAY_DIFFER: Final = ("control_ns", "counter")
"""Fields of an answer that depend on its time and on the number of frames, not on what was computed."""

UNRECORDED_S: Final = 0.01
LESS: Final = 0.5
"""Patience with a slot beside that with the one before it, in which nothing came: a process that ended costs two patiences, and
`UNRECORDED_S` a slot."""

MOST_TAKEN: Final = 1000
"""Frames that the other end takes between two that are played: a link of one's own may never be empty."""

LONGEST_GAP_S: Final = 3600.0
"""Of a session, between two frames; a log with a longer one would be played for years, in silence."""

MOST_TOLD: Final = 20
"""Differences that are kept, at most."""


class Difference(Struct, frozen=True, kw_only=True):
    """One field of one answer.

    Args:
        slot: of the answer.
        field: of `ControlPacket`; "answer" where one of the two is missing, "answers" of a slot that is answered again.
        recorded, now: its values, in words.
    """

    slot: int
    field: str
    recorded: str
    now: str

    def __str__(self) -> str:
        return f"slot {self.slot}: {self.field} = {self.recorded} recorded, {self.now} now"


class AnswerComparison(Struct, frozen=True, kw_only=True):
    """Result of sending the recorded frames to a controller process.

    Args:
        compared: answers that were compared.
        different: answers that differ.
        differences: the first fields that do, in order of slots.
    """

    compared: int
    different: int
    differences: tuple[Difference, ...]


def ask_process(
    run: Run, uri: str, source: str = "the log", patience_s: float = 15.0, *, start_s: float = 60.0
) -> AnswerComparison:  # fmt: skip
    """Send the recorded sensor frames to a running controller process, and compare its answers with the recorded ones.

    Args:
        run: the log.
        uri: of the link on which the controller's process is.
        source: the log's name, for messages.
        patience_s: how long the controller has for the answer of a slot, s; less after one in which nothing came.
        start_s: how long it has to start, up to its first answer, s.

    Raises:
        HilError: the log has no frames, or no controller answers.
    """
    refuse_changed(run, source, "a controller's process")
    recorded = _answers_of(run)
    wire = recorded_wire(run)
    if not recorded:
        raise HilError(f"{source}: holds no answers to compare with")
    uri = _as_in_the_run(run, uri, source, asks=True)
    compared = different = 0
    found: list[Difference] = []
    with opened(uri, "rig") as link:
        begun = Wire(nonce=wire.nonce, hello=before(wire.nonce(0)))
        result = Handshake(link, start_s, lambda: False, monotonic_ns, begun).greet()
        if not result.answered:
            came = useless_frames(uri, link.counters, result.foreign)
            raise HilError(f"no controller answered on {uri} within {start_s:g} s" + (f"; {came}" if came else ""))
        left_s, answered = patience_s, -1
        for k, group in groupby(frames(run.pieces(SENSOR.name, BATCH)), key=itemgetter(0)):
            for _, data in group:
                link.send(data)
            answer, again, silent = None, False, True
            for packet in _control_packets(link, left_s if k in recorded else UNRECORDED_S):
                silent = False
                if packet.seq == k:
                    answer = packet
                    break
                again = again or packet.seq == answered
            own = [Difference(slot=answered, field="answers", recorded="1", now="more")] * again
            answered = answered if answer is None else k
            if k in recorded:
                left_s = max(LESS * left_s, UNRECORDED_S) if silent else patience_s
                compared += 1
                own += differences(k, recorded[k], answer)
            different += bool(own)
            found += own[: MOST_TOLD - len(found)]
    return AnswerComparison(compared=compared, different=different, differences=tuple(found))


def _answers_of(run: Run) -> dict[int, ControlPacket]:
    """Return the first answer to every slot, in time or late."""
    found: dict[int, ControlPacket] = {}
    for _, data in frames(run.pieces(CONTROL.name, BATCH)):
        packet = decode(data)
        if isinstance(packet, ControlPacket):
            found.setdefault(packet.seq, packet)
    return found


def _control_packets(link: Link, patience_s: float) -> Iterator[ControlPacket]:
    """Yield the control packets that come within the patience."""
    limit = monotonic_ns() + round(patience_s * 1e9)
    while (left := limit - monotonic_ns()) > 0:
        data = link.receive(left / 1e9)
        packet = decode(data) if data is not None else None
        if isinstance(packet, ControlPacket):
            yield packet


def differences(k: int, recorded: ControlPacket, now: ControlPacket | None) -> Iterator[Difference]:
    """Yield the fields in which two answers differ, without `MAY_DIFFER`; numbers may differ in the last bits of the wire.

    Args:
        k: their slot.
        recorded: in the log.
        now: None where none came.
    """
    if now is None:
        yield Difference(slot=k, field="answer", recorded=str(recorded.rows), now="nothing")
        return
    for field in ControlPacket._fields:
        a, b = getattr(recorded, field), getattr(now, field)
        if field not in MAY_DIFFER and not near_values(a, b):
            yield Difference(slot=k, field=field, recorded=str(a), now=str(b))


def _as_in_the_run(run: Run, uri: str, source: str, *, asks: bool) -> str:
    """Return a link on which the run's nodes have CAN identifiers of their own, where it had more than one.

    Args:
        run: the log.
        uri: of the link.
        source: the log's name, for messages.
        asks: whether its other end is the controller of the run, which may have messages of its own.
    """
    external = asks and run.session.get("external_controller") == "True"
    if not run.resolved.get("network", {}).get("nodes") and not (external and run.resolved.get("links", {}).get("messages")):
        return uri
    return link_of(rig_of(experiment_of(run, source)), uri, external=external).uri


class Playback(Struct, frozen=True, kw_only=True):
    """How a playback kept its own time: error of each frame against its recorded instant, us."""

    frames: int
    error_us: dict[str, float | None]


def onto(run: Run, uri: str, speed: float, progress: Callable[[int, int], None]) -> Playback:
    """Put the recorded frames of both directions on a link, with their recorded spacing divided by ``speed``.

    Raises:
        HilError: the log has no frames, or one stands more than `LONGEST_GAP_S` behind the one before it.
    """
    count = sum(len(run.numbers(topic)) for topic in FRAME_TOPICS)
    ways = [_of_role(run, topic, role) for topic, role in zip(FRAME_TOPICS, ("rig", "controller"), strict=True)]
    schedule = heapq.merge(*ways, key=itemgetter(0))
    begin = next(schedule, None)
    if begin is None:
        raise HilError("the log has no frames to play")
    errors_us = np.empty(count)
    uri = _as_in_the_run(run, uri, "the log", asks=False)
    with opened(uri, "rig") as rig, opened(uri, "controller") as controller:
        links = {"rig": rig, "controller": controller}
        clock = RealClock(monotonic_ns() + 100_000_000)
        before_ns = begin[0]
        for i, (t_ns, role, data) in enumerate(chain([begin], schedule)):
            if (gap_s := (t_ns - before_ns) / 1e9) > LONGEST_GAP_S:
                raise HilError(f"frame {i} is {gap_s:g} s behind the one before it, at most {LONGEST_GAP_S:g} s are played")
            before_ns = t_ns
            at = round((t_ns - begin[0]) / speed)
            clock.wait_until(at)
            errors_us[i] = (clock.now() - at) / 1e3
            links[role].send(data)
            for _ in range(MOST_TAKEN):  # our own other end receives what we play; keep its queue short
                if links["controller" if role == "rig" else "rig"].receive(0) is None:
                    break
            progress(i, count)
    return Playback(frames=count, error_us=percentiles(errors_us))


def _of_role(run: Run, topic: str, role: str) -> Iterator[tuple[int, str, bytes]]:
    return ((t_ns, role, data) for t_ns, data in measured_frames(run, topic))
