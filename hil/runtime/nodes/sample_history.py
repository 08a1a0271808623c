"""The samples of sensor packets, kept as long as a controller looks back."""

from __future__ import annotations

from collections.abc import Sequence

from design.controllers import Sample
from hil.rig.sensor_list import Sensor


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
