"""The faults of a run at the rig: what they break of the network, and the events that tell when."""

from __future__ import annotations

from typing import Any

from hil.experiment.rig_tables import RESTART, Fault
from hil.rig.loop import Loop
from hil.rig.schedules import fault_text
from hil.runtime.nodes.journal import Journal
from hil.runtime.streams import rng_for
from transport.medium import IndependentChannels, Medium, OneWay
from transport.medium.faulted import FaultedMedium, FaultyPath
from transport.medium.independent import Impairment
from transport.packets import packet_size


class FaultInjector:
    """Breaks the network of a rig as the time line of its experiment says.

    Args:
        loop: the composed experiment; one without faults breaks nothing.
        seed: seed of the run.
        changing: whether faults may come to the time line in the run.
    """

    def __init__(self, loop: Loop, seed: int, changing: bool = False) -> None:
        line = loop.rig.fault_schedule
        self._faults = _in_slots(loop)
        self.there = changing or bool(self._faults)
        self._nodes, self._actuator = [FaultyPath(spells) for spells in line.nodes], FaultyPath(line.actuator)
        self._rng = rng_for(seed, "fault")

    def change(self, loop: Loop) -> None:
        """Go on with the time line of a changed experiment."""
        self._faults = _in_slots(loop)
        for path, spells in zip(self._nodes, loop.rig.fault_schedule.nodes, strict=True):
            path.plan(spells)
        self._actuator.plan(loop.rig.fault_schedule.actuator)

    def uplink(self, medium: Medium) -> Medium:
        """Return the way to the controller, with its faults."""
        return FaultedMedium(medium, self._nodes) if self.there else medium

    def downlink(self, channel: Impairment) -> Impairment:
        """Return the way to the actuator, with its faults."""
        return OneWay(FaultedMedium(IndependentChannels([channel]), [self._actuator])) if self.there else channel

    def mangled(self) -> list[tuple[int, int, Any]]:
        """Return what arrives in this slot with a flipped bit: (node, slot of its sample, packet)."""
        return [(node, g, packet) for node, path in enumerate(self._nodes) for g, packet in path.mangled]

    def flip(self, frame: bytes) -> bytes:
        """Return a frame with one bit flipped, drawn among those that leave its length as it was."""
        while True:
            place, bit = divmod(int(self._rng.integers(8 * len(frame))), 8)
            wrong = bytes([*frame[:place], frame[place] ^ 1 << bit, *frame[place + 1 :]])
            if packet_size(wrong) == packet_size(frame):
                return wrong

    def log_events(self, t_ns: int, k: int, journal: Journal) -> None:
        """Log the faults that begin or end in slot k.

        Args:
            t_ns: nominal time of the slot, ns.
            k: slot.
            journal: takes the events.
        """
        for i, (first, end, fault) in enumerate(self._faults):
            if k == first:
                self._event(journal, t_ns, k, f"fault: {fault.kind}", fault_text(fault), i, "warning")
            elif k == end and fault.kind != RESTART:
                self._event(journal, t_ns, k, f"fault over: {fault.kind}", f"{fault_text(fault)}: over", i, "info")

    def _event(self, journal: Journal, t_ns: int, k: int, kind: str, message: str, number: int, severity: str) -> None:
        first, end, fault = self._faults[number]
        journal.event(
            t_ns, kind, message, slot=k, severity=severity, fault=number, broken=fault.kind, link=fault.link, node=fault.node,
            slots=end - first,
        )  # fmt: skip


def _in_slots(loop: Loop) -> list[tuple[int, int, Fault]]:
    """Return first slot, end and fault of every one on the time line."""
    return [(*fault.slots(float(loop.experiment.period)), fault) for fault in loop.experiment.fault]
