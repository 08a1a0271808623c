"""Where the rows of send-all packets under way are kept in the state of the closed loop."""

from __future__ import annotations

from design.processes.delay_chain import DelayChain


class PacketRegisters(list[tuple[int, int]]):
    """Shift registers of packet rows under way: (first state, length in samples), with the label each one serves."""

    def __init__(self, items: list[tuple[int, int]], labels: list[int]) -> None:
        super().__init__(items)
        self.labels = labels

    def first_of(self, label: int) -> int:
        """First state of the register that serves a label."""
        return self[self.labels.index(label)][0]


def packet_registers(selection: str, ca: DelayChain, start: int, m: int) -> PacketRegisters:
    """Lay out the registers from state `start` on.

    The controller knows which row will be applied (`constant`, `generated`, `previous`): one register as long as the
    largest delay, at least one sample because z needs u1(k-1). The actuator chooses (`applied`, `both`): one register
    per label of the C-A delay, as long as that label's delay.
    """
    if selection not in ("applied", "both"):
        return PacketRegisters([(start, max(ca.max_delay, 1))], [0])
    items, labels = [], []
    for label, delay in enumerate(ca.label_delay):
        if delay > 0:
            items.append((start, int(delay)))
            labels.append(label)
            start += int(delay) * m
    if not items:
        return PacketRegisters([(start, 1)], [0])
    return PacketRegisters(items, labels)
