"""What a controller node makes of sensor packets: the newest sample of one node, or what several nodes have sent."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from design.controllers import FromSamples, Known, Rows, RunningController, Sample
from hil.compose.sensors import Sensor

Reference = Callable[[int], tuple[float, ...]]


class Assembly:
    """Keeps what several nodes have sent, as long as a controller needs it, and hands it over newest first.

    Args:
        sensors: the nodes, by number.
        memory: age in slots of the oldest sample that is kept, besides the newest one of each node.
    """

    def __init__(self, sensors: Sequence[Sensor], memory: int) -> None:
        self._widths = [(len(sensor.outputs or ()), sensor.buffer) for sensor in sensors]
        self._memory = memory
        self._samples: list[dict[int, tuple[float, ...]]] = [{} for _ in sensors]
        self.newest = -1

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
        self.newest = max(self.newest, slot)

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


class OneSensorAdapter:
    """Serves a controller of one sensor from several nodes: the newest sample of every output, as old as the oldest of them.

    Until every node has been heard it answers zeros, as before the first sample of one node. A node that may keep silent by its
    trigger is not waited for: until then its outputs are 0.

    Args:
        running: the controller.
        sensors: the nodes, by number.
        outputs: number p of the plant's outputs.
        nothing: rows of zeros.
    """

    memory = 0

    def __init__(self, running: RunningController, sensors: Sequence[Sensor], outputs: int, nothing: Rows) -> None:
        self.selection = running.selection
        self._running, self._sensors, self._outputs, self._nothing = running, sensors, outputs, nothing
        self._waited = {i for i, sensor in enumerate(sensors) if sensor.trigger.kind == "every-slot"}

    def rows(self, k: int, known: Known) -> Rows:
        """Return the rows of the adapted controller; see `FromSamples.rows`."""
        y, oldest, heard = [0.0] * self._outputs, k, set()
        for node, slot, values in known.samples:  # newest first
            if node not in heard:
                heard.add(node)
                oldest = min(oldest, slot)
                for output, value in zip(self._sensors[node].outputs or (), values):
                    y[output] = value
        if not self._waited <= heard:
            return self._nothing
        return self._running.rows(k, k - oldest, tuple(y), known.reference)


def from_samples(
    running: RunningController | FromSamples, sensors: Sequence[Sensor], outputs: int, nothing: Rows
) -> FromSamples:
    """Return a controller that several nodes can serve: itself where it takes samples, else behind an adapter."""
    return running if isinstance(running, FromSamples) else OneSensorAdapter(running, sensors, outputs, nothing)
