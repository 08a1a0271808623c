"""The samples that a controller has received from its sensor nodes: the newest of each, or all back to a given age."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from design.controllers import Known, MultiSampleController, Rows, RunningController, Sample
from hil.plugins import is_ours
from hil.rig.loop import Loop, Running
from hil.rig.sensors import Sensor
from transport.packets import SensorPacket

if TYPE_CHECKING:
    from hil.runtime.nodes.answer_watch import AnswerWatch


class SampleHistory:
    """Keeps what sensor nodes have sent, as long as a controller needs it, and hands it over newest first.

    Args:
        sensors: the nodes, by number.
        memory: age in slots of the oldest sample that is kept, besides the newest one of each node.
    """

    def __init__(self, sensors: Sequence[Sensor], memory: int) -> None:
        self._widths = [(len(sensor.outputs), sensor.buffer) for sensor in sensors]
        self._memory = memory
        self._samples: list[dict[int, tuple[float, ...]]] = [{} for _ in sensors]

    def fits(self, node: int, nodes: int, samples: int, values: int) -> bool:
        """Return whether a packet has the shape of that node's packets."""
        return nodes == len(self._widths) and self._widths[node] == (values // samples, samples) and values % samples == 0

    def take(self, node: int, slot: int, y: tuple[float, ...]) -> None:
        """Keep the samples of one packet; those from before slot 0 were never measured.

        Args:
            node: number of the node.
            slot: of the newest sample.
            y: samples, newest first.
        """
        width, count = self._widths[node]
        own = self._samples[node]
        for i in range(min(count, slot + 1)):
            own[slot - i] = y[i * width : (i + 1) * width]

    def known(self, k: int) -> tuple[Sample, ...]:
        """Return what is known in slot k, newest first, and forget what is too old."""
        found = []
        for node, own in enumerate(self._samples):
            last = max(own, default=-1)
            for slot in [slot for slot in own if slot < k - self._memory and slot != last]:
                del own[slot]
            found += [Sample(node, slot, values) for slot, values in own.items()]
        found.sort(key=lambda sample: (-sample.slot, sample.node))
        return tuple(found)


def controller_input(loop: Loop) -> NewestSample | EverySample:
    """Return a fresh control law with its memory of samples: `EverySample` for a `MultiSampleController`, else `NewestSample`."""
    running = loop.start_controller()
    return EverySample(loop, running) if isinstance(running, MultiSampleController) else NewestSample(loop, running)


def in_tuples(running: Running) -> Callable[..., Rows]:
    """Return the `rows` of a control law, in tuples where it is the user's own and may return lists.

    Compiled, a loop takes nothing else.
    """
    rows: Callable[..., Sequence[Sequence[float]]] = running.rows
    return running.rows if is_ours(running) else lambda *known: tuple(map(tuple, rows(*known)))


def _watch(loop: Loop, running: RunningController | MultiSampleController) -> AnswerWatch | None:
    """Return the comparison of a control law with its table; None for a controller that is ours, or that has no table."""
    if loop.watched is None or loop.watched.controller is None or is_ours(loop.controller):
        return None
    stated, has_reference = loop.watched.controller, bool(loop.experiment.reference)
    if _runs_as(running, stated.start(loop.model)):  # the very one that runs, and not one that was started before it
        return None
    from hil.runtime.nodes.answer_watch import AnswerWatch

    return AnswerWatch(running, loop.controller, stated, loop.model, has_reference=has_reference)


def _runs_as(running: Running, stated: Running) -> bool:
    """Return whether a controller that runs is what it states: both of one class, bit for bit the same inside."""
    if type(running) is not type(stated):
        return False
    try:
        return pickle.dumps(running) == pickle.dumps(stated)
    except (pickle.PicklingError, AttributeError, TypeError):  # it holds what has no bytes, such as a function
        return False


class NewestSample:
    """Serves a `RunningController`: the newest sample of every output, as old as the oldest of them.

    Until a packet of every node has come it answers zeros, as before the first sample of one node. It does not wait for a node
    that may keep silent by its trigger: until then its outputs are 0.

    Args:
        loop: the composed experiment.
        running: the control law.

    Attributes:
        watch: compares the answers with the table; None where they are not compared.
        sample_ns: time stamp of the newest sample of any node, -1 before the first.
    """

    def __init__(self, loop: Loop, running: RunningController) -> None:
        e, sensors = loop.experiment, loop.rig.sensors
        outputs = len(e.plant.outputs)
        self.watch = _watch(loop, running)
        self._rows = in_tuples(running) if self.watch is None else self.watch.rows
        self._reference, self._period_ns = loop.reference(), e.period_ns
        self._nothing: Rows = ((0.0,) * len(e.plant.inputs),) * loop.rows
        self._lengths = [len(s.outputs) * s.buffer for s in sensors]
        self._waited = [i for i, s in enumerate(sensors) if s.trigger.kind == "every-slot"]
        # One node that measures the outputs in their order: the beginning of its packet is what the control law takes.
        self._whole = sensors[0].outputs == tuple(range(outputs))
        self._width = outputs * loop.samples
        self._places = [[i * outputs + output for i in range(loop.samples) for output in s.outputs] for s in sensors]
        self._sampled_ns = [-1] * len(sensors)
        self._y: tuple[float, ...] = (0.0,) * self._width
        self.sample_ns = -1

    def take(self, packet: SensorPacket) -> bool:
        """Keep a packet unless a newer one is here; return False if it is not of this loop."""
        node, y, sample_ns = packet.node, packet.y, packet.sample_ns
        if packet.nodes != len(self._lengths) or len(y) != self._lengths[node]:
            return False
        if sample_ns >= self._sampled_ns[node]:
            self._sampled_ns[node] = sample_ns
            if sample_ns > self.sample_ns:
                self.sample_ns = sample_ns
            self._y = y[: self._width] if self._whole else self._with(node, y)
        return True

    def _with(self, node: int, y: tuple[float, ...]) -> tuple[float, ...]:
        known = list(self._y)
        for place, value in zip(self._places[node], y):
            known[place] = value
        return tuple(known)

    def rows(self, k: int) -> Rows:
        """Return what the control law says in slot k, once a sample is there."""
        sampled = self._sampled_ns
        oldest = sampled[0] if len(sampled) == 1 else self._oldest()  # one node, at once: 7 % of an interpreted virtual slot
        if oldest < 0:
            return self._nothing
        return self._rows(k, (k * self._period_ns - oldest) // self._period_ns, self._y, self._reference.at(k))

    def change_reference(self, loop: Loop) -> None:
        """Take the reference of a changed experiment."""
        self._reference = loop.reference()

    def _oldest(self) -> int:
        sampled = self._sampled_ns
        return -1 if any(sampled[i] < 0 for i in self._waited) else min(ns for ns in sampled if ns >= 0)


class EverySample:
    """Serves a `MultiSampleController`: the samples of each node, as old as the control law needs them.

    Args:
        loop: the composed experiment.
        running: the control law.

    Attributes:
        watch, sample_ns: see `NewestSample`.
    """

    def __init__(self, loop: Loop, running: MultiSampleController) -> None:
        self.watch = _watch(loop, running)
        self._rows = in_tuples(running) if self.watch is None else self.watch.rows
        self._reference, self._period_ns = loop.reference(), loop.experiment.period_ns
        self._assembly = SampleHistory(loop.rig.sensors, running.memory)
        self.sample_ns = -1

    def take(self, packet: SensorPacket) -> bool:
        """Keep the samples of a packet; see `NewestSample.take`."""
        slot, rest = divmod(packet.sample_ns, self._period_ns)
        if rest or slot < 0 or not self._assembly.fits(packet.node, packet.nodes, packet.samples, len(packet.y)):
            return False
        self._assembly.take(packet.node, slot, packet.y)
        self.sample_ns = max(self.sample_ns, packet.sample_ns)
        return True

    def rows(self, k: int) -> Rows:
        """Return what the control law says; see `NewestSample.rows`."""
        return self._rows(k, Known(self._assembly.known(k), self._reference.at(k)))

    def change_reference(self, loop: Loop) -> None:
        """Take another reference; see `NewestSample.change_reference`."""
        self._reference = loop.reference()
