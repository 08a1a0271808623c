"""What a log can be asked afterwards: was it so, what would another controller have done, put it on a bus again."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import packet_samples
from hil.compose.loop import Loop, compose
from hil.errors import HilError
from hil.experiment import Experiment, experiment_from_resolved
from hil.log.growing import Growing, pieces, whole
from hil.log.read.arrays import StructuredArray
from hil.log.read.export import FRAME_TOPICS, measured_frames
from hil.log.read.run import Run
from hil.replay_compare import BATCH, Comparison, in_time
from hil.runtime.nodes.actuator_node import OK, row_index
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.nodes.wire import VERSION_1, Wire
from hil.runtime.slot import Hear, Slot
from hil.runtime.time.clock import RealClock, monotonic_ns
from transport.links.opening import open_link
from transport.packets import ControlPacket, SensorPacket, decode

REMEMBERED = 4096
"""Slots beyond the longest delay of which answers are kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Outcome of a verification.

    Args:
        answers, states: control packets and plant states that were compared and found identical.
        difference: the first differing sample, None if all are identical.
    """

    answers: int
    states: int
    difference: str | None


def experiment_of(run: Run, source: str) -> Experiment:
    """Return the experiment that a log carries."""
    if not run.resolved:
        raise HilError(f"{source}: the log carries no resolved experiment")
    return experiment_from_resolved(run.resolved, run.experiment_text, source)


def _frames(pieces: Iterator[StructuredArray]) -> Iterator[tuple[int, bytes]]:
    """Give slot and bytes of every frame."""
    for piece in pieces:
        yield from zip(piece["tick"].tolist(), map(bytes, piece["data"]))


def _answers(loop: Loop, run: Run) -> Iterator[tuple[int, bytes]]:
    """Feed the recorded sensor frames to the loop's controller; give the slot and its answer."""
    node = ControlNode(loop)
    for tick, data in _frames(run.pieces("/link/sensor", BATCH)):
        answer = node.hear(data)
        if answer is not None:
            yield tick, answer


class Heard:
    """The control packets that arrived in time, asked for slot by slot.

    Args:
        run: the log.
    """

    def __init__(self, run: Run) -> None:
        numbers = in_time(run.numbers("/link/control"))
        ticks = whole(numbers, "tick")
        self.slots = np.unique(ticks)
        frames = _frames(map(in_time, run.pieces("/link/control", BATCH)))
        # A dict keeps the last of one slot; in a log that is in order it need hold no more than the slot at hand.
        self._held: dict[int, bytes] = {} if (ticks[1:] >= ticks[:-1]).all() else dict(frames)
        self._frames = frames
        self._next = next(self._frames, None)

    def get(self, k: int) -> bytes | None:
        """Return the packet of a slot; slots are asked for in order."""
        while self._next is not None and self._next[0] <= k:
            self._held = {self._next[0]: self._next[1]}
            self._next = next(self._frames, None)
        return self._held.get(k)


class Recorded:
    """The link of a replay: what was recorded answers, and our controller says whether it would have said the same.

    Args:
        loop: the composed experiment.
        heard: the control packets that arrived in time.
        foreign: somebody else's controller answered; ours is not asked.
    """

    def __init__(self, loop: Loop, heard: Heard, foreign: bool) -> None:
        self._node, self._heard, self._foreign = ControlNode(loop), heard, foreign
        self._period_ns = loop.experiment.period_ns
        self._answer: bytes | None = None
        self.difference: tuple[int, str] | None = None

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Ask our controller."""
        answers = [answer for answer in map(self._node.hear, frames) if answer is not None]
        self._answer = answers[-1] if answers else None

    def answer(self, t_ns: int, hear: Hear) -> None:
        """Hand over what was recorded, and compare."""
        k = t_ns // self._period_ns
        recorded = self._heard.get(k)
        if recorded is None:
            return
        hear(recorded)
        if not self._foreign and self._answer != recorded:
            text = f"control packet of slot {k}: {_words(recorded)} recorded, {_words(self._answer)} now"
            self.difference = (k, text)


def _wire(run: Run) -> Wire:
    """Return version and nonces of the recorded questions."""
    slots, nonces, versions = Growing(np.int64), Growing(np.uint64), set()
    for piece in run.pieces("/link/sensor", BATCH):
        asked = {tick: decode(bytes(data)) for tick, data in zip(piece["tick"].tolist(), piece["data"])}
        questions = {tick: packet for tick, packet in asked.items() if isinstance(packet, SensorPacket)}
        versions |= {packet.version for packet in questions.values()}
        slots.extend(np.fromiter(questions, np.int64, len(questions)))
        nonces.extend(np.fromiter((packet.nonce for packet in questions.values()), np.uint64, len(questions)))
    if versions <= {1}:
        return VERSION_1
    ticks, numbers = slots.array(), nonces.array()
    if (ticks[1:] < ticks[:-1]).any():
        order = np.argsort(ticks, kind="stable")
        ticks, numbers = ticks[order], numbers[order]

    def nonce(k: int) -> int:
        at = int(np.searchsorted(ticks, k, side="right")) - 1
        return int(numbers[at]) if at >= 0 and ticks[at] == k else 0

    return Wire(version=2, nonce=nonce)


def verify(run: Run, source: str = "log") -> Verdict:
    """Run controller and rig again on the recorded control packets; compare every record, bit for bit.

    What is not compared: times measured (``/timing/tick``), late packets, events, and the packets of a foreign controller.

    Raises:
        HilError: if the log has no slots.
    """
    experiment = experiment_of(run, source)
    loop = compose(experiment, certify=False)
    foreign = run.session.get("external_controller") == "True"
    applied = run.numbers("/actuator/applied")
    if not len(applied):
        raise HilError(f"{source}: the log holds no slots")
    ended = any(event["kind"] == "outcome" for event in run.events)
    slots = int(applied["tick"][-1]) + ended  # the last slot of a rig that was killed may be torn
    heard = Heard(run)
    channels = loop.channels()
    again = Comparison(run, channels, sorted(topic for topic in channels if topic != "/timing/tick"), slots)
    rig = Rig(loop, int(run.metadata["seed"]), again.sink, channels, lambda: None, _wire(run))
    recorded = Recorded(loop, heard, foreign)
    slot = Slot(rig, recorded, stopped=lambda: recorded.difference is not None)
    for k in range(slots):
        slot.run(k * experiment.period_ns)
        if recorded.difference is not None:
            slots = k
            break
        if k % BATCH == BATCH - 1:
            again.compare()
    again.compare()
    differences = [] if recorded.difference is None else [recorded.difference]
    differences += again.differences(slots)
    first, text = min(differences, default=(slots, None))
    answers = 0 if foreign else int(np.count_nonzero(heard.slots < first))
    return Verdict(answers=answers, states=min(first, slots), difference=text)


def _words(data: bytes | None) -> str:
    packet = decode(data) if data is not None else None
    return str(packet.rows) if isinstance(packet, ControlPacket) else "nothing"


def what_if(run: Run, controller: Any, kind: str, source: str = "log") -> dict[str, NDArray[np.float64]]:
    """Ask what another controller would have commanded on the recorded arrivals (the plant does not react).

    Returns:
        ``t_s``, and per input ``recorded_<name>`` (as applied) and ``<kind>_<name>`` (the row with the recorded d and selection
        history, NaN where nothing was applied).
    """
    experiment = experiment_of(run, source)
    other = compose(
        _with_controller(experiment, controller, kind), certify=False
    )
    if other.samples != (carried := packet_samples(experiment.controller)):
        raise HilError(f"{source}: its sensor packets carry {carried} samples, {kind} takes {other.samples}")
    applied = run.numbers("/actuator/applied")
    names = [f[2:] for f in applied.dtype.names or () if f.startswith("w_")]
    if not any((piece["status"] == OK).any() for piece in pieces(applied)):
        raise HilError(f"{source}: the log has no slot with an applied command, so replay compares nothing")
    d_max, selection = other.model.d_max, other.start_controller().selection
    d = array("i", whole(applied, "d").astype(np.int32).tobytes())
    answers, recent = _answers(other, run), _Recent(d_max + REMEMBERED)
    rows = [Growing(np.float64) for _ in names]
    for piece in pieces(applied, BATCH):
        found = []
        for k, g, status in zip(piece["tick"].tolist(), piece["packet_tick"].tolist(), piece["status"].tolist()):
            packet = recent.of(g, answers) if status == OK else None
            if isinstance(packet, ControlPacket):
                found.append(packet.rows[row_index(selection, k - g, g, d, d_max)])
            else:
                found.append((math.nan,) * len(names))
        for i, column in enumerate(rows):
            column.extend(np.array([row[i] for row in found]))
    out: dict[str, NDArray[np.float64]] = {"t_s": whole(applied, "t_ns") / 1e9}
    for name, column in zip(names, rows):
        out[f"recorded_{name}"] = whole(applied, name)
        out[f"{kind}_{name}"] = column.array()
    return out


class _Recent:
    """The answers of the last slots: what the actuator may still apply."""

    def __init__(self, slots: int) -> None:
        self._slots, self._last = slots, -1
        self._packets: dict[int, SensorPacket | ControlPacket | None] = {}

    def of(self, g: int, answers: Iterator[tuple[int, bytes]]) -> SensorPacket | ControlPacket | None:
        """Return the answer of a slot, reading on as far as need be."""
        while self._last <= g and (more := next(answers, None)) is not None:
            self._last = more[0]
            self._packets[more[0]] = decode(more[1])
            if len(self._packets) > self._slots:
                del self._packets[next(iter(self._packets))]
        return self._packets.get(g)


def _with_controller(experiment: Experiment, controller: Any, kind: str) -> Experiment:
    return replace(
        experiment, controller=controller, kinds={**experiment.kinds, "controller": kind}, allow_uncertified=True
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Playback:
    """How a playback kept its own time: error of each frame against its recorded instant, us."""

    frames: int
    error_us: dict[str, float]


def onto(run: Run, uri: str, speed: float = 1.0, progress: Callable[[int, int], None] = lambda i, n: None) -> Playback:
    """Put the recorded frames of both directions on a link, with their recorded spacing divided by ``speed``."""
    schedule: list[tuple[int, str, bytes]] = []
    for topic, role in zip(FRAME_TOPICS, ("rig", "controller"), strict=True):
        schedule += [(t_ns, role, bytes(data)) for t_ns, data in measured_frames(run, topic)]
    schedule.sort(key=lambda entry: entry[0])
    if not schedule:
        raise HilError("the log has no frames to play")
    error = np.empty(len(schedule))
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as controller:
        links = {"rig": rig, "controller": controller}
        clock = RealClock(monotonic_ns() + 100_000_000)
        first = schedule[0][0]
        for i, (t_ns, role, data) in enumerate(schedule):
            at = round((t_ns - first) / speed)
            clock.wait_until(at)
            error[i] = (clock.now() - at) / 1e3
            links[role].send(data)
            while links["controller" if role == "rig" else "rig"].receive(0) is not None:
                pass  # our own other end hears what we play; keep its queue short
            if i % 50 == 0:
                progress(i, len(schedule))
    points = {"p50": 50, "p99": 99, "p99_9": 99.9, "max": 100}
    return Playback(
        frames=len(schedule), error_us={name: float(np.percentile(error, q)) for name, q in points.items()}
    )
