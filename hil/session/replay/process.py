"""A controller's process beside what it said once: the recorded questions over a real link, its answers beside the recorded ones.

The idea is openpilot's process replay: what a process reads and publishes is data, so a change of it shows as a difference of
data. The rig's frames are those of the log, bit for bit; what the answers may differ in stands in `MAY_DIFFER`. A slot waits for
its answer, so nothing depends on how fast the process or the machine is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Final

from hil.errors import HilError
from hil.log.run import Run
from hil.log.topics import CONTROL, SENSOR
from hil.rig.normal_form import rig_of
from hil.rig.session_link import link_of
from hil.runtime.nodes.wire import Wire, before
from hil.runtime.real.exchange import Handshake
from hil.runtime.time.clock import monotonic_ns
from hil.session.replay.compare import BATCH, near_values
from hil.session.replay.recorded import frames, recorded_wire, refuse_changed
from hil.session.replay.replay import experiment_of
from transport.links.link import Link
from transport.links.opening import open_link
from transport.packets import ControlPacket, decode

MAY_DIFFER: Final = ("control_ns", "counter", "tag")
"""Fields of an answer that tell when it was made and how often was asked, not what was computed."""

MOST_TOLD: Final = 20
"""Differences that are kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One field of one answer.

    Args:
        slot: of the answer.
        field: of `ControlPacket`; "answer" where one of the two is missing.
        recorded, now: its values, in words.
    """

    slot: int
    field: str
    recorded: str
    now: str

    def __str__(self) -> str:
        return f"slot {self.slot}: {self.field} = {self.recorded} recorded, {self.now} now"


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What came of it.

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
) -> Asked:  # fmt: skip
    """Put the recorded questions to a controller that runs, and compare its answers with the recorded ones.

    Args:
        run: the log.
        uri: of the link on which the controller's process is.
        source: the log's name, for messages.
        patience_s: how long the controller has for the answer of a slot, s.
        start_s: how long it has to start, up to its first answer, s.

    Raises:
        HilError: the log has no frames, or no controller answers.
    """
    refuse_changed(run, source, "a controller's process")
    recorded = _answers_of(run)
    wire = recorded_wire(run)
    if not recorded:
        raise HilError(f"{source}: holds no answers to compare with")
    if run.resolved.get("nodes"):  # each on its own CAN identifiers
        uri = link_of(rig_of(experiment_of(run, source)), uri).uri
    compared = different = 0
    found: list[Difference] = []
    with open_link(uri, "rig") as link:
        begun = Wire(nonce=wire.nonce, hello=before(wire.nonce(0)))
        if not Handshake(link, start_s, lambda: False, monotonic_ns, begun).greet().answered:
            raise HilError(f"no controller answered on {uri} within {start_s:g} s")
        for k, group in groupby(frames(run.pieces(SENSOR.name, BATCH)), key=itemgetter(0)):
            for _, data in group:
                link.send(data)
            if k not in recorded:
                continue  # it was lost; what comes is passed over
            compared += 1
            own = list(differences(k, recorded[k], _answer(link, k, patience_s)))
            different += bool(own)
            found += own[: MOST_TOLD - len(found)]
    return Asked(compared=compared, different=different, differences=tuple(found))


def _answers_of(run: Run) -> dict[int, ControlPacket]:
    """Return the first answer to every slot, in time or late."""
    found: dict[int, ControlPacket] = {}
    for _, data in frames(run.pieces(CONTROL.name, BATCH)):
        packet = decode(data)
        if isinstance(packet, ControlPacket):
            found.setdefault(packet.seq, packet)
    return found


def _answer(link: Link, k: int, patience_s: float) -> ControlPacket | None:
    limit = monotonic_ns() + round(patience_s * 1e9)
    while (left := limit - monotonic_ns()) > 0:
        data = link.receive(left / 1e9)
        packet = decode(data) if data is not None else None
        if isinstance(packet, ControlPacket) and packet.seq == k:
            return packet
    return None


def differences(k: int, recorded: ControlPacket, now: ControlPacket | None) -> Iterator[Difference]:
    """Give the fields in which two answers differ, but for `MAY_DIFFER`; numbers may differ in the last bits of the wire.

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
