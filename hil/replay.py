"""What a log can be asked afterwards: was it so, what would another controller have done, put it on a bus again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import packet_samples
from hil.compose.loop import Loop, compose
from hil.errors import HilError
from hil.experiment import Experiment, experiment_from_resolved
from hil.log.read.arrays import StructuredArray
from hil.log.read.export import FRAME_TOPICS, measured_ns
from hil.log.read.run import Run
from hil.log.write.sinks import MemorySink
from hil.runtime.nodes.actuator_node import OK, row_index
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.nodes.wire import VERSION_1, Wire
from hil.runtime.slot import Hear, Slot
from hil.runtime.time.clock import RealClock, monotonic_ns
from transport.links.opening import open_link
from transport.packets import ControlPacket, SensorPacket, decode


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


def _answers(loop: Loop, run: Run) -> dict[int, bytes]:
    """Feed the recorded sensor frames to the loop's controller; return its answer per slot."""
    node = ControlNode(loop)
    out = {}
    frames = run.arrays["/link/sensor"]
    for tick, data in zip(frames["tick"].tolist(), frames["data"]):
        answer = node.hear(bytes(data))
        if answer is not None:
            out[tick] = answer
    return out


class Recorded:
    """The link of a replay: what was recorded answers, and our controller says whether it would have said the same.

    Args:
        loop: the composed experiment.
        heard: slot to the control packet that arrived in time.
        foreign: somebody else's controller answered; ours is not asked.
    """

    def __init__(self, loop: Loop, heard: Mapping[int, bytes], foreign: bool) -> None:
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
    frames = run.arrays["/link/sensor"]
    asked = {tick: decode(bytes(data)) for tick, data in zip(frames["tick"].tolist(), frames["data"])}
    questions = {tick: packet for tick, packet in asked.items() if isinstance(packet, SensorPacket)}
    if all(packet.version == 1 for packet in questions.values()):
        return VERSION_1
    return Wire(version=2, nonce=lambda k: questions[k].nonce if k in questions else 0)


def verify(run: Run, source: str = "log") -> Verdict:
    """Run controller and rig again on the recorded control packets; compare every record, bit for bit.

    What is not compared: times measured (``/timing/tick``), late packets, events, and the packets of a foreign controller.

    Raises:
        HilError: if the log has no slots.
    """
    experiment = experiment_of(run, source)
    loop = compose(experiment, certify=False)
    foreign = run.session.get("external_controller") == "True"
    applied = run.arrays["/actuator/applied"]["tick"]
    if not len(applied):
        raise HilError(f"{source}: the log holds no slots")
    ended = any(event["kind"] == "outcome" for event in run.events)
    slots = int(applied[-1]) + ended  # the last slot of a rig that was killed may be torn
    control = _in_time(run.arrays["/link/control"])
    heard = dict(zip(control["tick"].tolist(), map(bytes, control["data"])))

    again = MemorySink(loop.channels())
    rig = Rig(loop, int(run.metadata["seed"]), again, loop.channels(), lambda: None, _wire(run))
    recorded = Recorded(loop, heard, foreign)
    slot = Slot(rig, recorded, stopped=lambda: recorded.difference is not None)
    for k in range(slots):
        slot.run(k * experiment.period_ns)
        if recorded.difference is not None:
            slots = k
            break
    differences = [] if recorded.difference is None else [recorded.difference]
    now = Run.from_memory(again).arrays
    for topic in sorted(now):
        if topic != "/timing/tick":
            difference = _first_difference(topic, _in_time(run.arrays[topic]), now[topic], slots)
            differences += [difference] if difference is not None else []
    first, text = min(differences, default=(slots, None))
    return Verdict(answers=0 if foreign else sum(k < first for k in heard), states=min(first, slots), difference=text)


def _in_time(records: StructuredArray) -> StructuredArray:
    return records[records["late"] == 0] if "late" in (records.dtype.names or ()) else records


def _first_difference(topic: str, recorded: StructuredArray, now: StructuredArray, slots: int) -> tuple[int, str] | None:
    """Return the first slot below ``slots`` in which two series of records differ, and how."""
    recorded, now = recorded[recorded["tick"] < slots], now[now["tick"] < slots]
    n = min(len(recorded), len(now))
    a, b = recorded[:n], now[:n]
    names = [name for name in now.dtype.names or () if name != "tick"]
    differs = {name: (a[name] != b[name]) & ((a[name] == a[name]) | (b[name] == b[name])) for name in ["tick", *names]}
    where = np.flatnonzero(np.any([*differs.values()], axis=0))
    if not where.size and len(recorded) == len(now):
        return None
    i = int(where[0]) if where.size else n
    if i >= n or differs["tick"][i]:
        missing = i < len(now) and (i >= len(recorded) or recorded["tick"][i] > now["tick"][i])
        slot = int((now if missing else recorded)["tick"][i])
        return slot, f"{topic}: a record of slot {slot} is {'missing' if missing else 'there that should not be'}"
    name, slot = next(name for name in names if differs[name][i]), int(now["tick"][i])
    return slot, f"{topic} of slot {slot}: {name} = {a[name][i]} recorded, {b[name][i]} now"


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
    answers = {tick: decode(data) for tick, data in _answers(other, run).items()}
    applied = run.arrays["/actuator/applied"]
    names = [f[2:] for f in applied.dtype.names or () if f.startswith("w_")]
    d_max, selection = other.model.d_max, other.start_controller().selection
    d = applied["d"].tolist()
    rows = []
    for k, g, status in zip(applied["tick"].tolist(), applied["packet_tick"].tolist(), applied["status"].tolist()):
        packet = answers.get(g)
        if status != OK or not isinstance(packet, ControlPacket):
            rows.append((math.nan,) * len(names))
            continue
        rows.append(packet.rows[row_index(selection, k - g, g, d, d_max)])
    if not any(status == OK for status in applied["status"].tolist()):
        raise HilError(f"{source}: no slot in which a command was applied: there is nothing to compare with")
    out: dict[str, NDArray[np.float64]] = {"t_s": applied["t_ns"] / 1e9}
    for i, name in enumerate(names):
        out[f"recorded_{name}"] = applied[name]
        out[f"{kind}_{name}"] = np.array([row[i] for row in rows])
    return out


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
        schedule += [(t_ns, role, bytes(data)) for t_ns, data in zip(measured_ns(run, topic), run.arrays[topic]["data"])]
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
