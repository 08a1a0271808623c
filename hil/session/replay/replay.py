"""Verifies a log by running it again, and computes the commands of another controller on the recorded samples."""

from __future__ import annotations

import math
import os
from array import array
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from design.controllers import Controller, controller_traits
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import Experiment, experiment_from_resolved
from hil.experiment.table import UnavailablePlugin
from hil.log.append_column import AppendColumn, pieces, whole
from hil.log.run import Run
from hil.log.topics import APPLIED, SENSOR, TIMING, channels_of, in_log_of
from hil.plugins.registry import OBJECT
from hil.plugins.user_plugins import Designer
from hil.rig.loop import Array, Loop
from hil.runtime.changes import take
from hil.runtime.nodes.actuator_node import OK, row_index
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.slot import OnFrame, Slot
from hil.session.replay import BATCH, Comparison, near_frames
from hil.session.replay.recorded import RecordedAnswers, Woken, changes_of, composed, frames, recorded_wire, refuse_changed
from transport.packets import ControlPacket, SensorPacket, decode, encode_control

REMEMBERED = 4096
"""Slots beyond the longest delay for which answers are kept."""


Likeness = Literal["same bits", "same within 1e-9", "different"]


class Verdict(Struct, frozen=True, kw_only=True):
    """Outcome of a verification.

    Args:
        likeness: ``same bits``; ``same within 1e-9`` of the largest value of every signal, and of what a frame carries two units
            in the last place of single precision; or ``different``.
        answers, states: control packets and plant states that were compared and found alike.
        difference: the first sample that is not alike, None if all bits are the same.
    """

    likeness: Likeness
    answers: int
    states: int
    difference: str | None


def experiment_of(
    run: Run, source: str, *, plant: object = None, controller: object = None, laws: Mapping[str, object] | None = None,
    folder: str | None = None,
) -> Experiment:  # fmt: skip
    """Return the experiment that a log carries.

    Args:
        run: the log.
        source: its name, for messages.
        plant, controller: what ran, where it was built in Python; no file holds it.
        laws: network laws that were built in Python, by their paths.
        folder: where the file of an own module or an FMU stands; nothing of it is read without being asked to.

    Raises:
        HilError: what ran cannot be made again, with what it takes.
    """
    if not run.resolved:
        raise HilError(f"{source}: the log carries no resolved experiment")
    if folder is not None and not os.path.isdir(folder):
        raise HilError(f"folder {folder!r}: is no folder; expected that in which the files stand that the experiment names")
    objects = {name: given for name, given in (("plant", plant), ("controller", controller)) if given is not None}
    objects |= laws or {}
    experiment = experiment_from_resolved(run.resolved, run.experiment_text, source, folder=folder, objects=objects)
    absent = [part for part in (experiment.plant, experiment.controller) if isinstance(part, UnavailablePlugin)]
    if absent:
        text = "; ".join(f"its {part.field} was {part.why}" for part in absent)
        asked = ", ".join(f"{part.field}=..." for part in absent if part.kind.startswith(OBJECT))
        helps = [f"in Python, hil.verify({source!r}, {asked}) takes what ran"] if asked else []
        if any(not part.kind.startswith(OBJECT) for part in absent):
            helps.append("--folder DIR (in Python folder=...) says where its file stands")
        raise HilError(f"{source}: {text}; {'; '.join(helps)}")
    return experiment


def changed_files(run: Run, experiment: Experiment) -> list[str]:
    """Return a sentence for every module of the user's own whose text is not that of the module that ran.

    Args:
        run: the log.
        experiment: made again from it.
    """
    now = experiment.origins()
    pairs = {name: (run.metadata.get(name), now.get(name)) for name in ("plant", "controller", *now)}
    return [f"{name}: {was} ran; now it is {runs}" for name, (was, runs) in pairs.items() if was and runs and was != runs]


def _answers(loop: Loop, run: Run) -> Iterator[tuple[int, bytes]]:
    """Feed the recorded sensor frames to the loop's controller; yield the slot and its answer."""
    node = ControlNode(loop)
    for slot, data in frames(run.pieces(SENSOR.name, BATCH)):
        answer = node.on_frame(data)
        if answer is not None:
            yield slot, answer


class Recorded:
    """The exchange of a replay: it hands over the recorded answers, and compares them with those of our controller.

    Args:
        loop: the composed experiment.
        received: the control packets that arrived in time.
        foreign: an external controller answered; the answers are not compared.
    """

    def __init__(self, loop: Loop, received: RecordedAnswers, foreign: bool) -> None:
        self.node, self._received, self._foreign = ControlNode(loop), received, foreign
        self._period_ns = loop.experiment.period_ns
        self._answer: bytes | None = None
        self.difference: tuple[int, str] | None = None  # of bits
        self.far: tuple[int, str] | None = None

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Let our controller answer."""
        answers = [answer for answer in map(self.node.on_frame, frames) if answer is not None]
        self._answer = answers[-1] if answers else None

    def answer(self, t_ns: int, on_frame: OnFrame) -> None:
        """Hand over the recorded answer, and compare it."""
        k = t_ns // self._period_ns
        recorded = self._received.get(k)
        if recorded is None:
            return
        on_frame(recorded)
        if not self._foreign and self._answer != recorded and _without_tag(self._answer) != _without_tag(recorded):
            text = f"control packet of slot {k}: {_words(recorded)} recorded, {_words(self._answer)} now"
            self.difference = self.difference or (k, text)
            if self._answer is None or not near_frames(recorded, self._answer):
                self.far = (k, text)


def verify(run: Run, source: str = "log", experiment: Experiment | None = None) -> Verdict:
    """Run controller and rig again on the recorded control packets; compare every record.

    What is not compared: times measured (``/timing/slot``), late packets, events, and the packets of a foreign controller. A log
    that ends before the slot up to which the rig says that it ran is different.

    Args:
        run: the log.
        source: its name, for messages.
        experiment: that of `experiment_of`, where the log alone was not enough.

    Raises:
        HilError: if the log has no slots.
        MissingTopic: it lacks a topic of its run.
    """
    experiment = experiment_of(run, source) if experiment is None else experiment
    loop = compose(experiment, certify=False)
    foreign = run.session.get("external_controller") == "True"
    applied = run.numbers(APPLIED.name)
    if not len(applied):
        raise HilError(f"{source}: the log holds no slots")
    ended = [event["data"] for event in run.events if event["kind"] == "outcome"]
    slots = int(applied["slot"][-1]) + bool(ended)  # the last slot of a rig that was killed may be torn
    short = [(slots, f"the log ends with slot {slots - 1}; the rig says that it ran {n} slots")
             for n in (data.get("slots", slots) for data in ended if isinstance(data, dict)) if n != slots]  # fmt: skip
    received = RecordedAnswers(run)
    channels = channels_of(loop)
    known = [topic for topic in channels if topic in run.arrays or in_log_of(run.versions, topic)]
    compared = sorted({*known} - {TIMING.name})
    run.needs(*compared)
    again = Comparison(run, channels, compared, slots)
    began = Woken(run, experiment.period_ns).at
    asked = changes_of(run)
    rig = Rig(
        loop, int(run.metadata["seed"]), again.sink, channels, lambda: None, recorded_wire(run), woken=began, changing=bool(asked)
    )  # fmt: skip
    recorded = Recorded(loop, received, foreign)
    changes = list(composed(loop, asked, certify=False))
    slot = Slot(rig, recorded, stopped=lambda: recorded.far is not None)
    for k in range(slots):
        while changes and changes[0][0] <= k:
            take(changes.pop(0)[1], rig, recorded.node)
        slot.run(k * experiment.period_ns)
        if recorded.far is not None:
            slots = k
            break
        if not k % BATCH:
            again.compare()
    again.compare()
    far = again.differences(slots, far=True) + ([] if recorded.far is None else [recorded.far]) + short
    exact = again.differences(slots) + ([] if recorded.difference is None else [recorded.difference])
    likeness: Likeness = "different" if far else "same within 1e-9" if exact else "same bits"
    _, text = min(far or exact, default=(slots, None))
    alike = min(far, default=(slots, ""))[0]
    return Verdict(
        likeness=likeness, answers=0 if foreign else received.answered(alike), states=min(alike, slots), difference=text
    )


def _without_tag(data: bytes | None) -> bytes | None:
    """Return an answer without its tag, which the link adds, and its counter, which also counts lost answers."""
    packet = decode(data) if data is not None else None
    return encode_control(packet._replace(counter=0)) if isinstance(packet, ControlPacket) else data


def _words(data: bytes | None) -> str:
    packet = decode(data) if data is not None else None
    return str(packet.rows) if isinstance(packet, ControlPacket) else "nothing"


def what_if(
    run: Run, controller: Controller | Designer, kind: str, source: str = "log", experiment: Experiment | None = None
) -> dict[str, Array]:
    """Compute the commands of another controller on the recorded samples (the plant does not react).

    Args:
        run: the log.
        controller: parameters of the other one.
        kind: its name.
        source: name of the log, for messages.
        experiment: that of `experiment_of`, where the log alone was not enough.

    Returns:
        ``t_s``, and per input ``recorded_<name>`` (as applied) and ``<kind>_<name>`` (the row with the recorded d and selection
        history, NaN where nothing was applied).
    """
    refuse_changed(run, source, "what another controller would have commanded")
    experiment = experiment_of(run, source) if experiment is None else experiment
    kinds = {**experiment.kinds, "controller": kind}
    other = compose(replace(experiment, controller=controller, kinds=kinds, allow_uncertified=True), certify=False)
    if other.samples != (carried := controller_traits(experiment.controller).samples):
        raise HilError(f"{source}: its sensor packets carry {carried} samples, {kind} takes {other.samples}")
    applied = run.numbers(APPLIED.name)
    names = [f[2:] for f in applied.dtype.names or () if f.startswith("w_")]
    if not any((piece["status"] == OK).any() for piece in pieces(applied)):
        raise HilError(f"{source}: the log has no slot with an applied command, so replay compares nothing")
    d_max, selection = other.model.d_max, other.start_controller().selection
    d = array("i", whole(applied, "d").astype(np.int32).tobytes())
    answers, recent = _answers(other, run), _Recent(d_max + REMEMBERED)
    rows = [AppendColumn(np.float64) for _ in names]
    for piece in pieces(applied, BATCH):
        found = []
        for k, g, status in zip(piece["slot"].tolist(), piece["packet_slot"].tolist(), piece["status"].tolist()):
            packet = recent.of(g, answers) if status == OK else None
            if isinstance(packet, ControlPacket):
                found.append(packet.rows[row_index(selection, k - g, g, d, d_max, other.rig.row_sojourns)])
            else:
                found.append((math.nan,) * len(names))
        for i, column in enumerate(rows):
            column.extend(np.array([row[i] for row in found]))
    out: dict[str, Array] = {"t_s": whole(applied, "t_ns") / 1e9}
    for name, column in zip(names, rows):
        out[f"recorded_{name}"] = whole(applied, name)
        out[f"{kind}_{name}"] = column.array()
    return out


class _Recent:
    """The answers of the last slots, which the actuator may still apply."""

    def __init__(self, slots: int) -> None:
        self._slots, self._last = slots, -1
        self._packets: dict[int, SensorPacket | ControlPacket | None] = {}

    def of(self, g: int, answers: Iterator[tuple[int, bytes]]) -> SensorPacket | ControlPacket | None:
        """Return the answer of a slot; answers are read on up to this slot."""
        while self._last <= g and (more := next(answers, None)) is not None:
            self._last = more[0]
            self._packets[more[0]] = decode(more[1])
            if len(self._packets) > self._slots:
                del self._packets[next(iter(self._packets))]
        return self._packets.get(g)
