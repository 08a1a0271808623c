"""Load of a CAN bus that takes time: waiting and response times of every message, with their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.errors import HilError
from hil.log.append_column import pieces
from hil.log.topics import BUS, EXTENDED
from hil.measure.view import RunView
from hil.rig.can_bus import CONTROLLER, analysed, bus_nodes, can_bus_of, is_disturbed, own_packets, rates_of
from transport.can_analysis import bus_load, response_times


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageOnBus:
    """One message, as it was on the bus.

    Args:
        name: of the message.
        can_id: its identifier; `extended` where it has 29 bits.
        node: name of the node that sent it.
        frames: that got through.
        errors: that were destroyed.
        load: share of the bus that it took, destroyed frames included.
        waited_ms, waited_worst_ms: from Transmit to the start of the frame that got through, mean and worst; None without one.
        response_worst_ms: from Transmit to the end of its EOF, the worst.
        bound_ms: the analytic bound of the response time; None where there is none, bits are disturbed or frames are recorded.
    """

    name: str
    can_id: int
    extended: bool
    node: str
    frames: int
    errors: int
    load: float
    waited_ms: float | None
    waited_worst_ms: float | None
    response_worst_ms: float | None
    bound_ms: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLoad:
    """The bus of a run.

    Args:
        name: of the medium.
        bitrate, dbitrate: bit/s; None without CAN FD.
        load: share of the run in which it was in use.
        stated_load: the sum of the longest frames over their periods.
        frames, errors: that got through, and that were destroyed.
        messages: by priority, as the identifiers win.
        own_nodes: names of the nodes of the rig that send on it.
        longest: record of the longest wait of a packet of theirs.
    """

    name: str
    bitrate: int
    dbitrate: int | None
    load: float
    stated_load: float
    frames: int
    errors: int
    messages: tuple[MessageOnBus, ...]
    own_nodes: tuple[str, ...]
    longest: int


class _Counted:
    """Counts of one identifier, over the pieces of the log."""

    def __init__(self) -> None:
        self.node, self.length = -1, 0
        self.frames = self.errors = self.used_ns = self.waited_ns = 0
        self.waited_worst_ns = self.response_worst_ns = -1
        self.longest = -1  # record of the longest wait

    def take(self, records: npt.NDArray[np.void], indices: npt.NDArray[np.int64]) -> None:
        self.node, self.length = int(records["node"][0]), max(self.length, int(records["length"].max()))
        good = records["operation"] == 0
        self.frames += int(good.sum())
        self.errors += int((~good).sum())
        self.used_ns += int((records["idle_ns"] - records["start_ns"]).sum())
        sent = records[good]
        if len(sent):
            waited = sent["start_ns"] - sent["queued_ns"]
            self.waited_ns += int(waited.sum())
            if int(waited.max()) > self.waited_worst_ns:
                self.waited_worst_ns, self.longest = int(waited.max()), int(indices[good][int(np.argmax(waited))])
            self.response_worst_ns = max(self.response_worst_ns, int((sent["end_ns"] - sent["queued_ns"]).max()))


def _counted(records: npt.NDArray[np.void]) -> dict[tuple[bool, int], _Counted]:
    found: dict[tuple[bool, int], _Counted] = {}
    at = 0
    for piece in pieces(records):
        keys = (piece["flags"] & EXTENDED).astype(np.int64) << 32 | piece["can_id"]
        for key in np.unique(keys).tolist():
            mine = np.flatnonzero(keys == key)
            found.setdefault((bool(key >> 32), key & 0xFFFFFFFF), _Counted()).take(piece[mine], mine + at)
        at += len(piece)
    return found


def bus_of(view: RunView) -> BusLoad | None:
    """Return the load of the bus of a run; None where it has none, or cannot be made again here."""
    records, rig = view.run.arrays.get(BUS.name), view.rig
    bus = None if rig is None else can_bus_of(rig)
    if records is None or rig is None or bus is None or not len(records):
        return None
    medium, rates, names, counted = bus.table, rates_of(bus.table), bus_nodes(rig, bus), _counted(records)
    if not all(0 <= each.node < len(names) for each in counted.values()):
        raise HilError(f"topic {BUS.name}: node: expected numbers of the {len(names)} nodes of the bus")
    answers = sum(each.length for each in counted.values() if names[each.node] == CONTROLLER)
    rows = answers // (4 * len(rig.inputs)) or None
    stated = {(each.extended, each.identifier): each for each in analysed(rig, bus, rows)}
    disturbed = is_disturbed(medium, () if view.experiment is None else view.experiment.fault)
    bounds = {} if medium.recorded or disturbed else {
        each.message.name: each.response_ns for each in response_times([*stated.values()], rates)
    }  # fmt: skip
    span = int(records["idle_ns"][-1])

    def message(name: str, key: tuple[bool, int]) -> MessageOnBus:
        own = counted.get(key, _Counted())
        return MessageOnBus(
            name=name, can_id=key[1], extended=key[0], node=names[own.node] if own.node >= 0 else "", frames=own.frames,
            errors=own.errors, load=own.used_ns / span, waited_ms=own.waited_ns / own.frames / 1e6 if own.frames else None,
            waited_worst_ms=_ms(own.waited_worst_ns), response_worst_ms=_ms(own.response_worst_ns),
            bound_ms=_ms(bounds.get(name)),
        )  # fmt: skip

    messages = [message(each.name, key) for key, each in sorted(stated.items(), key=lambda item: item[1].key())]
    messages += [message(f"recorded {key[1]:#x}", key) for key in sorted(counted) if key not in stated]
    every = list(counted.values())
    senders = tuple(packet.sender for packet in own_packets(rig, bus))
    own_nodes = [each for each in every if names[each.node] in senders]
    return BusLoad(
        name=bus.name, bitrate=rates.bitrate, dbitrate=rates.dbitrate, load=sum(each.used_ns for each in every) / span,
        stated_load=float(bus_load([*stated.values()], rates)), frames=sum(each.frames for each in every),
        errors=sum(each.errors for each in every), messages=tuple(messages), own_nodes=senders,
        longest=max(own_nodes or every, key=lambda each: each.waited_worst_ns).longest,
    )  # fmt: skip


def _ms(ns: int | None) -> float | None:
    return None if ns is None or ns < 0 else ns / 1e6
